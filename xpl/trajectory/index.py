"""The index of a folder: a line for each file, so that nobody has to open thousands to know how long they are.

`index.jsonl` beside the files; a line is added when a file is put in place. It is only a shortcut: a file without a
line, or of another size than its line says, is opened instead.
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


class Line(NamedTuple):
    """What the index says of a file: its size and its control steps."""

    bytes: object
    steps: int


def note(path: Path, facts: Mapping[str, object]) -> None:
    """Add the line of a file that is in place.

    Raises:
        OSError: the index cannot be written.
    """
    line = {"file": path.name, "bytes": path.stat().st_size, **facts}
    data = json.dumps(line, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"
    handle = os.open(path.parent / NAME, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    try:
        os.write(handle, data)  # in one piece: others may add lines too
    finally:
        os.close(handle)


def lines(folder: Path) -> dict[str, Line]:
    """Return the newest line of each file by its name; a line that is none counts for nothing."""
    found: dict[str, Line] = {}
    path = folder / NAME
    try:
        if not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return found
        content = path.read_bytes()
    except OSError:
        return found
    for raw in content.split(b"\n"):
        try:
            told = json_text.parse(raw)
        except json_text.JsonError:
            continue
        if isinstance(told, dict) and isinstance(told.get("file"), str) and _is_count(told.get("steps")):
            found[told["file"]] = Line(told.get("bytes"), told["steps"])
    return found


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0
