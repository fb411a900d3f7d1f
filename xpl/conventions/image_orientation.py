"""Images rotated or mirrored. Source: spec/v1/model_io.schema.json#/$defs/step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import AdapterCase, Convention, GeometryStep, Mistake, image_changes, walk
from xpl.catalogue.edits import mistakes_at_sites
from xpl.catalogue.image_changes import StepEntry, append_step, change_steps, prepend_step, remove_steps, replace_steps

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


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = image_changes.sites(case.block)
    for rank, step in _TURNS:
        ((word, how),) = step.items()
        yield from mistakes_at_sites(sites, rank, f"{word}: {how} added", _NAME, change_steps(append_step(step)))
        yield from mistakes_at_sites(sites, 3, f"{word}: {how} first", _NAME, change_steps(prepend_step(step)))
        yield from mistakes_at_sites(sites, 1, f"{word}: {how}", _NAME, change_steps(replace_steps(word, step)))
    for word in ("rotate", "mirror"):
        yield from mistakes_at_sites(sites, 0, f"no {word}", _NAME, change_steps(remove_steps(word)))
    yield from mistakes_at_sites(
        sites, 1, "rotate: 180 instead of mirror", _NAME, change_steps(replace_steps("mirror", _HALF))
    )
    for how in ("left_right", "up_down"):
        flip = change_steps(replace_steps("rotate", {"mirror": how}))
        yield from mistakes_at_sites(sites, 1, f"mirror: {how} instead of rotate", _NAME, flip)


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    yield from image_changes.image_mistakes(0, "rotate: 180", _NAME, lambda one: _rotated(one, 180), case)
    yield from image_changes.image_mistakes(
        0, "mirror: left_right", _NAME, lambda one: _mirrored(one, "left_right"), case
    )
    yield from image_changes.image_mistakes(1, "mirror: up_down", _NAME, lambda one: _mirrored(one, "up_down"), case)


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if case.cameras:
        yield Mistake(2, "height and width exchanged", _NAME, input_change={"kind": "turned"})


def _transpose(value: Any, _how: object) -> Any:
    def change(array: Any, axis: int) -> Any:
        one, other = (-3, -2) if axis == -1 else (-2, -1)
        return np.ascontiguousarray(np.swapaxes(array, one, other))

    return walk.map_images(value, change)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    input_changes={"turned": _transpose},
    keys={"steps": ["rotate", "mirror"]},
    applies=lambda block: bool(block.get("images")),
    steps={
        "rotate": GeometryStep(
            _rotated,
            lambda values, how, _before: np.rot90(values, -how // 90),
            lambda how, before: (before[1], before[0]) if (how // 90) % 2 else before,
        ),
        "mirror": GeometryStep(_mirrored, lambda values, how, _before: _mirrored(values, how)),
    },
)
