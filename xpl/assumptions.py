"""Assumed values of a manifest: `{assumed: value, why: reason}` in place of a value.

Serving uses the value; the audit counts and names the assumption.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from xpl.nested import format_path

_KEYS = frozenset(("assumed", "why"))


@dataclass(frozen=True)
class Assumption:
    """A value without a source.

    Attributes:
        path: keys and indices that lead to it, from the outside in.
        value: the assumed value.
        why: the reason.
    """

    path: tuple[str | int, ...]
    value: Any
    why: str

    @property
    def where(self) -> str:
        """Its path as text: `model_io.images[0].channels`."""
        return format_path(self.path)


def resolve_assumptions(document: Any) -> Any:
    """Return a document with assumed values in place of the assumptions; the rest is not copied."""
    if _is_assumption(document):
        return resolve_assumptions(document["assumed"])
    if isinstance(document, Mapping):
        return {key: resolve_assumptions(value) for key, value in document.items()}
    if isinstance(document, list):
        return [resolve_assumptions(value) for value in document]
    return document


def assumptions(document: Any, path: tuple[str | int, ...] = ()) -> Iterator[Assumption]:
    """Yield the assumptions of a document, in its order."""
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
