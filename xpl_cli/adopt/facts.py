"""What is known of an adapter or a checkpoint: values with their sources, and why others are not known.

They lie in trees, maps and lists as a manifest has them. A leaf is `Told` or `Open`. What is neither stands for itself:
words of the block that the fact beside them brings along, such as the key of a part.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

UNKNOWN: Final = "unknown"
"""Key of an open value in a manifest."""

Tree = Any
"""A map, a list, a leaf, or a plain value."""


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
class Told:
    """A value that was read.

    Attributes:
        value: as the manifest has it.
        confidence: how sure it is.
        evidence: where it was read.
    """

    value: Any
    confidence: Confidence
    evidence: tuple[Evidence, ...]

    @property
    def comment(self) -> str:
        """Its source in one line."""
        return f"{self.confidence}: {'; '.join(map(str, self.evidence))}"


@dataclass(frozen=True)
class Open:
    """A value that nothing tells.

    Attributes:
        reason: why it is not known, and who would know.
        seen: places that may help.
        stand_in: what the manifest holds meanwhile where it has no form for what is open; such a place is marked.
    """

    reason: str
    seen: tuple[Evidence, ...] = ()
    stand_in: Any = None

    @property
    def value(self) -> Any:
        """What the manifest holds."""
        return {UNKNOWN: self.reason} if self.stand_in is None else self.stand_in

    @property
    def text(self) -> str:
        """The question in one line."""
        return f"{self.reason}; seen: {', '.join(map(str, self.seen))}" if self.seen else self.reason


def certain(value: object, *evidence: Evidence) -> Told:
    """Return a value that a file says exactly."""
    return Told(value, Confidence.CERTAIN, evidence)


def likely(value: object, *evidence: Evidence) -> Told:
    """Return a value that is named where this is usually told."""
    return Told(value, Confidence.LIKELY, evidence)


def assumed(value: object, why: str) -> Told:
    """Return a value that nothing contradicts."""
    return Told(value, Confidence.ASSUMED, (Evidence("", None, why),))


def plain(tree: Tree) -> Any:
    """Return a tree as the manifest holds it."""
    if isinstance(tree, (Told, Open)):
        return tree.value
    if isinstance(tree, dict):
        return {key: plain(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [plain(value) for value in tree]
    return tree


def leaves(tree: Tree, key: str) -> Iterator[tuple[str, Told | Open]]:
    """Yield every leaf with its dotted key, in the order of the tree."""
    if isinstance(tree, (Told, Open)):
        yield key, tree
    elif isinstance(tree, dict):
        for name, value in tree.items():
            yield from leaves(value, f"{key}.{name}" if key else str(name))
    elif isinstance(tree, list):
        for index, value in enumerate(tree):
            yield from leaves(value, f"{key}.{index}")


@dataclass(frozen=True)
class Findings:
    """What trees say, by dotted key of the manifest."""

    told: Mapping[str, Told]
    open: Mapping[str, Open]

    @classmethod
    def of(cls, sections: Mapping[str, Tree]) -> Self:
        """Return what sections of a manifest say."""
        found = [entry for key, tree in sections.items() for entry in leaves(tree, key)]
        return cls(
            {key: leaf for key, leaf in found if isinstance(leaf, Told)},
            {key: leaf for key, leaf in found if isinstance(leaf, Open)},
        )

    @property
    def counts(self) -> dict[str, int]:
        """How many values there are of each confidence."""
        return dict(Counter(str(leaf.confidence) for leaf in self.told.values()))

    def told_as_json(self) -> list[dict[str, Any]]:
        """Return what is known, for programs."""
        return [
            {
                "key": key,
                "value": leaf.value,
                "confidence": leaf.confidence.value,
                "evidence": [asdict(one) for one in leaf.evidence],
            }
            for key, leaf in self.told.items()
        ]

    def open_as_json(self) -> list[dict[str, Any]]:
        """Return what is not known, for programs."""
        return [
            {"key": key, "meaning": leaf.reason, "seen": [asdict(one) for one in leaf.seen]}
            for key, leaf in self.open.items()
        ]
