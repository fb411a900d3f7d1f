"""Unknown values of a manifest: `{unknown: why}` instead of a value.

A run treats such a key as missing; a check reports the reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

KEY: Final = "unknown"
_OWN: Final = frozenset(("model_io",))
"""Parts that keep their unknown values, which their readers handle (`xpl.convert.gaps`)."""

KeyPath = tuple[str | int, ...]


def reason(value: Any) -> str | None:
    """Return why a value is unknown; None for a known one."""
    is_open = isinstance(value, Mapping) and set(value) == {KEY} and isinstance(value[KEY], str)
    return value[KEY] if is_open else None


def split(document: object) -> tuple[Any, dict[KeyPath, str]]:
    """Return a manifest without its unknown values, and their reasons by path."""
    gaps: dict[KeyPath, str] = {}
    return _known(document, (), gaps), gaps


def known(document: object) -> Any:
    """Return a manifest without its unknown values, and without parts that become empty."""
    return _without_empty(document, split(document)[0])


def _without_empty(original: object, remaining: object) -> Any:
    if not isinstance(remaining, dict) or not isinstance(original, dict):
        return remaining
    entries = {key: _without_empty(original[key], entry) for key, entry in remaining.items()}
    return {key: entry for key, entry in entries.items() if entry != {} or original[key] == {}}


def _known(value: object, path: KeyPath, gaps: dict[KeyPath, str]) -> Any:
    if not isinstance(value, dict):
        return value
    result = {}
    for key, entry in value.items():
        why = reason(entry)
        if not path and key in _OWN:
            result[key] = entry
        elif why is not None:
            gaps[*path, key] = why
        else:
            result[key] = _known(entry, (*path, key), gaps)
    return result
