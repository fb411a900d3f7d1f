"""What is known of an adapter, where it was read, and how sure that is; and what is left to its author."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable


class Confidence(StrEnum):
    """How sure a fact is: what the author has to look at again."""

    CERTAIN = "certain"
    """A file or the code says exactly this."""
    LIKELY = "likely"
    """It is named where this is usually told."""
    ASSUMED = "assumed"
    """Nothing says otherwise, and the ecosystem's contract says this."""


@dataclass(frozen=True)
class Evidence:
    """A place that tells a fact.

    Attributes:
        file: relative to the package; "" for what lies in no file.
        line: from 1; None for the file as a whole.
        what: what was read there.
    """

    file: str
    line: int | None
    what: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line is not None else self.file
        return f"{place} {self.what}".strip()


@dataclass(frozen=True)
class Fact:
    """A value for one key of the manifest, such as `temporal.chunk`.

    Attributes:
        key: with dots between the levels.
        value: what the manifest says.
        confidence: how sure it is.
        evidence: where it was read; for a list that `is_itemised`, one place for each entry.
        is_itemised: whether each entry of the list has a source of its own.
    """

    key: str
    value: Any
    confidence: Confidence
    evidence: tuple[Evidence, ...]
    is_itemised: bool = False

    @property
    def comment(self) -> str:
        """The fact's source in one line."""
        return f"{self.confidence}: {'; '.join(map(str, self.evidence))}"

    def as_json(self) -> dict[str, Any]:
        """Return the fact for programs."""
        return {
            "key": self.key,
            "value": self.value,
            "confidence": self.confidence.value,
            "evidence": [asdict(entry) for entry in self.evidence],
        }


@dataclass(frozen=True)
class Question:
    """A key whose value nothing tells.

    Attributes:
        key: key of the manifest.
        meaning: what it says.
        options: values that would do; empty where it is a number or a text.
        seen: places that may help the author.
        stand_in: what the manifest holds until it is answered.
    """

    key: str
    meaning: str
    options: tuple[str, ...] = ()
    seen: tuple[Evidence, ...] = ()
    stand_in: Any = None

    @property
    def text(self) -> str:
        """The question in one line."""
        options = f" ({', '.join(self.options)})" if self.options else ""
        seen = f"; seen: {', '.join(map(str, self.seen))}" if self.seen else ""
        return f"{self.meaning}{options}{seen}"

    def as_json(self) -> dict[str, Any]:
        """Return the question for programs."""
        return {
            "key": self.key,
            "meaning": self.meaning,
            "options": list(self.options),
            "seen": [asdict(entry) for entry in self.seen],
        }


Finding = Fact | Question


def certain(key: str, value: Any, *evidence: Evidence) -> Fact:
    """Return a fact that the files say exactly."""
    return Fact(key, value, Confidence.CERTAIN, evidence)


def likely(key: str, value: Any, *evidence: Evidence) -> Fact:
    """Return a fact that its author should look at again."""
    return Fact(key, value, Confidence.LIKELY, evidence)


def weakest(facts: Iterable[Confidence]) -> Confidence:
    """Return the confidence of something that rests on several."""
    ranked = list(Confidence)
    return max(facts, key=ranked.index, default=Confidence.LIKELY)
