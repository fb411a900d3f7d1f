"""What is known of an adapter or a checkpoint, where it was read and how sure that is, and what is unknown."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any


class Confidence(StrEnum):
    """How sure a fact is: what the author has to look at again."""

    CERTAIN = "certain"
    """A file says exactly this."""
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
        evidence: where it was read.
    """

    key: str
    value: Any
    confidence: Confidence
    evidence: tuple[Evidence, ...]

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
        seen: places that may help the author.
    """

    key: str
    meaning: str
    seen: tuple[Evidence, ...] = ()

    @property
    def text(self) -> str:
        """The question in one line."""
        return f"{self.meaning}; seen: {', '.join(map(str, self.seen))}" if self.seen else self.meaning

    def as_json(self) -> dict[str, Any]:
        """Return the question for programs."""
        return {"key": self.key, "meaning": self.meaning, "seen": [asdict(entry) for entry in self.seen]}
