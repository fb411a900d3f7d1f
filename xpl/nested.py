"""Values inside of maps and lists, and how the place of one is written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Place = tuple[Any, ...]
"""Keys of maps and numbers of items, from the outside in."""


def leaves(value: object, place: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Yield what is neither map nor list in a value, with its place."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from leaves(item, (*place, name))
    elif isinstance(value, (list, tuple)):
        for number, item in enumerate(value):
            yield from leaves(item, (*place, number))
    else:
        yield place, value


def written(place: Sequence[Any]) -> str:
    """Return a place as people write it: `vision.cam_head.color`, `tasks[0].name`, `[0].left_ee_pose`."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")
