"""Values inside nested maps and lists, and their paths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

ValuePath = tuple[Any, ...]
"""Keys of maps and indices of items, from the outside in."""


def leaves(value: object, path: ValuePath = ()) -> Iterator[tuple[ValuePath, Any]]:
    """Yield (path, value) of each value that is neither map nor list."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from leaves(item, (*path, name))
    elif isinstance(value, (list, tuple)):
        for number, item in enumerate(value):
            yield from leaves(item, (*path, number))
    else:
        yield path, value


def format_path(path: Sequence[Any]) -> str:
    """Return a path as text: `vision.cam_head.color`, `tasks[0].name`, `[0].left_ee_pose`."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).removeprefix(".")
