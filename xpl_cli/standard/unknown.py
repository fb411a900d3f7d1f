"""What a manifest says that nobody knows: `{unknown: why}` in the place of a value.

Whoever runs a package takes such a key for one that is not there; whoever checks it is told the reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

KEY: Final = "unknown"
_OWN: Final = frozenset(("model_io",))
"""Parts that keep their gaps, since those who read them have values for them (`xpl.convert.gaps`)."""

KeyPath = tuple[str | int, ...]


def reason(value: Any) -> str | None:
    """Return why a value is not known; None if it is a value."""
    is_open = isinstance(value, Mapping) and set(value) == {KEY} and isinstance(value[KEY], str)
    return value[KEY] if is_open else None


def split(document: object) -> tuple[Any, dict[KeyPath, str]]:
    """Return a manifest without what is not known in it, and why that is not known, by place."""
    gaps: dict[KeyPath, str] = {}
    return _known(document, (), gaps), gaps


def known(document: object) -> Any:
    """Return a manifest without what is not known in it, and without the parts of which nothing is."""
    return _without_empty(document, split(document)[0])


def _without_empty(given: object, left: object) -> Any:
    if not isinstance(left, dict) or not isinstance(given, dict):
        return left
    entries = {key: _without_empty(given[key], entry) for key, entry in left.items()}
    return {key: entry for key, entry in entries.items() if entry != {} or given[key] == {}}


def _known(value: object, place: KeyPath, gaps: dict[KeyPath, str]) -> Any:
    if not isinstance(value, dict):
        return value
    known = {}
    for key, entry in value.items():
        why = reason(entry)
        if not place and key in _OWN:
            known[key] = entry
        elif why is not None:
            gaps[*place, key] = why
        else:
            known[key] = _known(entry, (*place, key), gaps)
    return known
