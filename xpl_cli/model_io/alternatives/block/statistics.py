"""What else a file of statistics holds: other data sets, other robots, the other vector."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from xpl import json_text
from xpl.convert import ConversionError, tables

if TYPE_CHECKING:
    from pathlib import Path

_SIZE_LIMIT = 16 * 2**20
_MOST = 32


def entries(file: str, folders: Sequence[Path], names: Sequence[str]) -> list[str]:
    """Return the keys, words separated by /, under which a file has all of these names; at most 32 of them."""
    path = tables.find(file, folders)
    if path is not None and path.suffix == ".safetensors":
        return _prefixes(path, names)
    if path is None or path.suffix != ".json" or path.stat().st_size > _SIZE_LIMIT:
        return []
    try:
        document = json_text.parse(path.read_bytes())
    except (OSError, json_text.JsonError):
        return []
    found = []
    for key in _walk(document, (), names):
        found.append(key)
        if len(found) == _MOST:
            break
    return found


def _prefixes(path: Path, names: Sequence[str]) -> list[str]:
    """Return what stands before the last dot of arrays of all of these names: `action` of `action.mean`."""
    try:
        there = set(tables.names(path))
    except (OSError, ConversionError):
        return []
    known = sorted({name.rpartition(".")[0] for name in there if "." in name})
    return [key for key in known if all(f"{key}.{name}" in there for name in names)][:_MOST]


def _walk(document: Any, way: tuple[str, ...], names: Sequence[str], depth: int = 8) -> Iterator[str]:
    if not isinstance(document, dict) or not depth:
        return
    if all(isinstance(document.get(name), list) for name in names):
        yield "/".join(way)
    for key, value in document.items():
        if "/" not in key:
            yield from _walk(value, (*way, key), names, depth - 1)
