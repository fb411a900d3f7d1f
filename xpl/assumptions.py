"""What a manifest assumes: `{assumed: value, why: reason}` in the place of a value.

Whoever runs a package takes the value; whoever checks it counts and names the assumption.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from xpl.nested import written

_KEYS = frozenset(("assumed", "why"))


@dataclass(frozen=True)
class Assumption:
    """A value that nobody was found to say.

    Attributes:
        path: keys and positions that lead to it, from the outside in.
        value: what is assumed.
        why: the reason.
    """

    path: tuple[str | int, ...]
    value: Any
    why: str

    @property
    def where(self) -> str:
        """Its place as people read it: `model_io.images[0].channels`."""
        return written(self.path)


def settled(document: Any) -> Any:
    """Return a document with each value that is assumed in its place; the rest is not copied."""
    if _is_assumption(document):
        return settled(document["assumed"])
    if isinstance(document, Mapping):
        return {key: settled(value) for key, value in document.items()}
    if isinstance(document, list):
        return [settled(value) for value in document]
    return document


def assumptions(document: Any, path: tuple[str | int, ...] = ()) -> Iterator[Assumption]:
    """Yield what a document assumes, in its order."""
    if _is_assumption(document):
        yield Assumption(path, document["assumed"], document["why"])
    elif isinstance(document, Mapping):
        for key, value in document.items():
            yield from assumptions(value, (*path, key))
    elif isinstance(document, list):
        for index, value in enumerate(document):
            yield from assumptions(value, (*path, index))


def _is_assumption(value: object) -> bool:
    if not isinstance(value, Mapping) or set(value) != _KEYS:
        return False
    return isinstance(value["why"], str) and bool(value["why"].strip())
