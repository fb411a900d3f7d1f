"""Images rotated or mirrored. Source: spec/v1/model_io.schema.json#/$defs/step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import Case, Convention, Mistake, Step, pictures, walk
from xpl.catalogue.edits import everywhere
from xpl.catalogue.pictures import StepEntry, appended, lacking, prepended, replaced, stepped

if TYPE_CHECKING:
    from collections.abc import Iterator

_NAME = "image_orientation"
_TURNS: tuple[tuple[int, StepEntry], ...] = (
    (0, {"rotate": 180}),
    (0, {"mirror": "left_right"}),
    (1, {"mirror": "up_down"}),
    (2, {"rotate": 90}),
    (2, {"rotate": 270}),
)
"""By likelihood."""
_HALF: StepEntry = {"rotate": 180}


def _rotated(values: np.ndarray, how: int) -> np.ndarray:
    return np.rot90(values, how // 90)


def _mirrored(values: np.ndarray, how: str) -> np.ndarray:
    return values[:, ::-1] if how == "left_right" else values[::-1]


def _in_block(case: Case) -> Iterator[Mistake]:
    sites = pictures.sites(case.block)
    for rank, step in _TURNS:
        ((word, how),) = step.items()
        yield from everywhere(sites, rank, f"{word}: {how} added", _NAME, stepped(appended(step)))
        yield from everywhere(sites, 3, f"{word}: {how} first", _NAME, stepped(prepended(step)))
        yield from everywhere(sites, 1, f"{word}: {how}", _NAME, stepped(replaced(word, step)))
    for word in ("rotate", "mirror"):
        yield from everywhere(sites, 0, f"no {word}", _NAME, stepped(lacking(word)))
    yield from everywhere(sites, 1, "rotate: 180 instead of mirror", _NAME, stepped(replaced("mirror", _HALF)))
    for how in ("left_right", "up_down"):
        flip = stepped(replaced("rotate", {"mirror": how}))
        yield from everywhere(sites, 1, f"mirror: {how} instead of rotate", _NAME, flip)


def _around(case: Case) -> Iterator[Mistake]:
    yield from pictures.shown(0, "rotate: 180", _NAME, lambda one: _rotated(one, 180), case)
    yield from pictures.shown(0, "mirror: left_right", _NAME, lambda one: _mirrored(one, "left_right"), case)
    yield from pictures.shown(1, "mirror: up_down", _NAME, lambda one: _mirrored(one, "up_down"), case)


def _in_inputs(case: Case) -> Iterator[Mistake]:
    if case.cameras:
        yield Mistake(2, "height and width exchanged", _NAME, encoded={"kind": "turned"})


def _turned(value: Any, _how: object) -> Any:
    def change(array: Any, axis: int) -> Any:
        one, other = (-3, -2) if axis == -1 else (-2, -1)
        return np.ascontiguousarray(np.swapaxes(array, one, other))

    return walk.pictures(value, change)


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    in_inputs=_in_inputs,
    kinds={"turned": _turned},
    keys={"steps": ["rotate", "mirror"]},
    applies=lambda block: bool(block.get("images")),
    steps={
        "rotate": Step(
            _rotated,
            lambda values, how, _before: np.rot90(values, -how // 90),
            lambda how, before: (before[1], before[0]) if (how // 90) % 2 else before,
        ),
        "mirror": Step(_mirrored, lambda values, how, _before: _mirrored(values, how)),
    },
)
