"""Values with their sources: maps and lists whose leaves say where they were read, or why they are not known.

A leaf is `Told` or `Open`. What is neither stands for itself: words of the block that the fact beside them brings
along, such as the key of a part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.adopt.facts import Confidence, Evidence, Fact, Question

if TYPE_CHECKING:
    from collections.abc import Iterator

UNKNOWN: Final = "unknown"
"""Key of an open value in a native block."""

Tree = Any
"""A map, a list, a leaf, or a plain value."""


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


def certain(value: Any, *evidence: Evidence) -> Told:
    """Return a value that a file says exactly."""
    return Told(value, Confidence.CERTAIN, evidence)


def likely(value: Any, *evidence: Evidence) -> Told:
    """Return a value that is named where this is usually told."""
    return Told(value, Confidence.LIKELY, evidence)


def assumed(value: Any, why: str) -> Told:
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


def findings(tree: Tree, key: str) -> Iterator[Fact | Question]:
    """Yield what a tree says as facts and questions of an adoption."""
    for name, leaf in leaves(tree, key):
        if isinstance(leaf, Told):
            yield Fact(name, leaf.value, leaf.confidence, leaf.evidence)
        else:
            yield Question(name, leaf.reason, leaf.seen)
