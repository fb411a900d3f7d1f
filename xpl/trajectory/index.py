"""Index of a folder, `index.jsonl`: number of steps of each file, so that files need not be opened.

A line is appended when a file is complete. The index is a cache: a file without a line, or of another size than in its
line, is opened instead.
"""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, NamedTuple

from xpl import json_text

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

NAME = "index.jsonl"
_MOST_BYTES = 1 << 28


class IndexEntry(NamedTuple):
    """Index entry of a file: size in bytes, number of control steps."""

    bytes: object
    steps: int


def append(path: Path, facts: Mapping[str, object]) -> None:
    """Append the line of a complete file.

    Raises:
        OSError: the index cannot be written.
    """
    line = {"file": path.name, "bytes": path.stat().st_size, **facts}
    data = json.dumps(line, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"
    handle = os.open(path.parent / NAME, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    try:
        os.write(handle, data)  # one write: other processes may append, too
    finally:
        os.close(handle)


def read(folder: Path) -> dict[str, IndexEntry]:
    """Return the newest entry of each file by name; malformed lines are ignored."""
    entries: dict[str, IndexEntry] = {}
    path = folder / NAME
    try:
        if not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return entries
        content = path.read_bytes()
    except OSError:
        return entries
    for raw in content.split(b"\n"):
        try:
            entry = json_text.parse(raw)
        except json_text.JsonError:
            continue
        if isinstance(entry, dict) and isinstance(entry.get("file"), str) and _is_count(entry.get("steps")):
            entries[entry["file"]] = IndexEntry(entry.get("bytes"), entry["steps"])
    return entries


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
