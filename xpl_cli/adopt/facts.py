"""Facts of an adapter or a checkpoint: values with their sources, and unknown values with the reason.

They form trees of maps and lists as in a manifest. A leaf is a `Fact` or an `UnknownFact`; any other value is a
literal, such as a keyword that a neighbouring fact implies.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Self

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

UNKNOWN: Final = "unknown"
"""Key of an unknown value in a manifest."""

Tree = Any
"""A map, a list, a leaf, or a plain value."""


class Confidence(StrEnum):
    """How certain a fact is: what the author has to check."""

    CERTAIN = "certain"
    """A file states exactly this."""
    LIKELY = "likely"
    """It is stated where this is usually stated."""
    ASSUMED = "assumed"
    """Nothing contradicts it, and it is the default of the ecosystem's contract."""


@dataclass(frozen=True)
class Evidence:
    """The source of a fact.

    Attributes:
        file: relative to the package; "" for a source that is no file.
        line: from 1; None for the file as a whole.
        what: what was read there.
    """

    file: str
    line: int | None
    what: str

    def __str__(self) -> str:
        location = f"{self.file}:{self.line}" if self.line is not None else self.file
        return f"{location} {self.what}".strip()


@dataclass(frozen=True)
class Fact:
    """A value with its source.

    Attributes:
        value: as in the manifest.
        confidence: how certain it is.
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
class UnknownFact:
    """A value that no source states.

    Attributes:
        reason: why it is unknown, and who would know.
        evidence: places that may help.
        placeholder: value in the manifest where its schema allows no `{unknown: why}`; it is marked by a comment.
    """

    reason: str
    evidence: tuple[Evidence, ...] = ()
    placeholder: Any = None

    @property
    def value(self) -> Any:
        """The value in the manifest."""
        return {UNKNOWN: self.reason} if self.placeholder is None else self.placeholder

    @property
    def text(self) -> str:
        """The question in one line."""
        return f"{self.reason}; see {', '.join(map(str, self.evidence))}" if self.evidence else self.reason


def certain(value: object, *evidence: Evidence) -> Fact:
    """Return a fact that a file states exactly."""
    return Fact(value, Confidence.CERTAIN, evidence)


def likely(value: object, *evidence: Evidence) -> Fact:
    """Return a fact that is stated where this is usually stated."""
    return Fact(value, Confidence.LIKELY, evidence)


def assumed(value: object, why: str) -> Fact:
    """Return a fact that is a default and that nothing contradicts."""
    return Fact(value, Confidence.ASSUMED, (Evidence("", None, why),))


def plain(tree: Tree) -> Any:
    """Return a tree as manifest values, without sources."""
    if isinstance(tree, (Fact, UnknownFact)):
        return tree.value
    if isinstance(tree, dict):
        return {key: plain(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [plain(value) for value in tree]
    return tree


def leaves(tree: Tree, key: str) -> Iterator[tuple[str, Fact | UnknownFact]]:
    """Yield every leaf with its dotted key, in the order of the tree."""
    if isinstance(tree, (Fact, UnknownFact)):
        yield key, tree
    elif isinstance(tree, dict):
        for name, value in tree.items():
            yield from leaves(value, f"{key}.{name}" if key else str(name))
    elif isinstance(tree, list):
        for index, value in enumerate(tree):
            yield from leaves(value, f"{key}.{index}")


@dataclass(frozen=True)
class ManifestFacts:
    """The facts and unknown values of a manifest, by dotted key."""

    facts: Mapping[str, Fact]
    unknown: Mapping[str, UnknownFact]

    @classmethod
    def of(cls, sections: Mapping[str, Tree]) -> Self:
        """Collect the leaves of sections of a manifest."""
        entries = [entry for key, tree in sections.items() for entry in leaves(tree, key)]
        return cls(
            {key: leaf for key, leaf in entries if isinstance(leaf, Fact)},
            {key: leaf for key, leaf in entries if isinstance(leaf, UnknownFact)},
        )

    @property
    def counts(self) -> dict[str, int]:
        """Number of facts of each confidence."""
        return dict(Counter(str(leaf.confidence) for leaf in self.facts.values()))

    def facts_as_json(self) -> list[dict[str, Any]]:
        """The facts as JSON values."""
        return [
            {
                "key": key,
                "value": leaf.value,
                "confidence": leaf.confidence.value,
                "evidence": [asdict(one) for one in leaf.evidence],
            }
            for key, leaf in self.facts.items()
        ]

    def unknown_as_json(self) -> list[dict[str, Any]]:
        """The unknown values as JSON values."""
        return [
            {"key": key, "meaning": leaf.reason, "evidence": [asdict(one) for one in leaf.evidence]}
            for key, leaf in self.unknown.items()
        ]
