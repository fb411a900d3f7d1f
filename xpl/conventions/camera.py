"""Which camera is which input, and how several become one. Source: spec/v1/model_io.schema.json, `images`."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import AdapterCase, Convention, Mistake, image_changes, walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl.catalogue.edits import Block
    from xpl.catalogue.mistake import BlockPath

_NAME = "camera"


def _likely(one: str, other: str) -> int:
    """Return the rank of an exchange: wrists are exchanged most."""
    return 0 if "wrist" in one and "wrist" in other else 1


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    entries = case.block.get("images") or []
    used = list(dict.fromkeys(camera for entry in entries for camera in entry["cameras"]))
    for one, other in sorted(itertools.combinations(used, 2), key=lambda pair: _likely(*pair)):
        places = {one: other, other: one}
        edits: dict[BlockPath, Any] = {
            ("images", index, "cameras"): [places.get(camera, camera) for camera in entry["cameras"]]
            for index, entry in enumerate(entries)
            if set(entry["cameras"]) & {one, other}
        }
        yield Mistake(_likely(one, other), f"cameras: {one} and {other} exchanged", _NAME, edits)
    for index, entry in enumerate(entries):
        yield from _camera_mistakes(index, entry, case.embodiment.cameras)


def _camera_mistakes(index: int, entry: Block, robot_cameras: Sequence[str]) -> Iterator[Mistake]:
    cameras = list(entry["cameras"])

    def listed(rank: int, order: Sequence[str], words: str) -> Mistake:
        label = f"cameras: {words} ({entry['input']})"
        return Mistake(rank, label, _NAME, {("images", index, "cameras"): list(order)})

    if len(cameras) > 2:
        for order in itertools.islice(itertools.permutations(cameras), 1, 25):
            yield listed(2, order, ", ".join(order))
    if len(cameras) == 2:
        yield listed(1, cameras[::-1], ", ".join(cameras[::-1]))
    for position, camera in enumerate(cameras):
        for other in robot_cameras:
            if other not in cameras:
                changed = [*cameras[:position], other, *cameras[position + 1 :]]
                yield listed(2, changed, f"{other} instead of {camera}")


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    cameras = case.cameras
    for one, other in itertools.combinations(cameras, 2):
        words = f"cameras: {one} and {other} exchanged"
        yield Mistake(
            _likely(one, other), words, _NAME, change_observations=image_changes.swap_cameras({one: other, other: one})
        )
    for one, other in itertools.permutations(cameras, 2):
        words = f"cameras: {other} instead of {one}"
        yield Mistake(2, words, _NAME, change_observations=image_changes.swap_cameras({one: other}))
    for turned in (1, -1) if len(cameras) > 2 else ():
        order = [*cameras[turned:], *cameras[:turned]]
        swap = image_changes.swap_cameras(dict(zip(cameras, order)))
        yield Mistake(2, f"cameras: {', '.join(order)}", _NAME, change_observations=swap)


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if case.cameras:
        words = "stack: two pictures the other way (width or height)"
        yield Mistake(2, words, _NAME, input_change={"kind": "beside"})


def _beside(value: Any, _how: object) -> Any:
    """Return two pictures in one that lie beside each other below each other instead, or the other way round."""

    def change(array: Any, axis: int) -> Any:
        rows, columns = (-3, -2) if axis == -1 else (-2, -1)
        height, width = array.shape[rows], array.shape[columns]
        if width == 2 * height:
            return np.concatenate(np.split(array, 2, columns), rows)
        return np.concatenate(np.split(array, 2, rows), columns) if height == 2 * width else None

    return walk.map_images(value, change)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    input_changes={"beside": _beside},
    keys={"images": ["cameras", "stack"]},
)
