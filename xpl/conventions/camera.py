"""Which camera is which input, and how several become one. Source: spec/v1/model_io.schema.json, `images`."""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import checkpoint, json_text
from xpl.catalogue import AdapterCase, Convention, Mistake, image_changes, walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from xpl.catalogue.edits import Block
    from xpl.catalogue.mistake import BlockPath

_NAME = "camera"
_INPUT = re.compile(r"[\w./-]*(?:image|cam|rgb|view|wrist)[\w./-]*", re.IGNORECASE)
"""Names that inputs of images have."""
_OWN_FILES = frozenset(("golden_pairs.json", checkpoint.TINY))
"""Files that are not the model's, and name cameras."""
_MOST_NAMES = 12
_MOST_FILES = 20
_MOST_BYTES = 1 << 20


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
    yield from _input_name_mistakes(entries, case.folders)


def _input_name_mistakes(entries: Sequence[Block], folders: Sequence[Path]) -> Iterator[Mistake]:
    """Yield other names of inputs: a model may take an image that it does not know for a camera that is missing."""
    own = [entry["input"] for entry in entries]
    names = [name for name in _configured_names(folders) if name not in own]
    for index, now in enumerate(own):
        alike = [name for name in names if _stem(now) in (now, _stem(name))]
        for name in alike[:_MOST_NAMES]:
            yield Mistake(1, f"input: {name}, not {now}", _NAME, {("images", index, "input"): name})


def _stem(name: str) -> str:
    """Return what comes before the last part of a dotted name or a path."""
    return re.split(r"[./](?=[^./]*$)", name)[0]


def _configured_names(folders: Sequence[Path]) -> list[str]:
    """Return the names of inputs of images in the JSON files of a checkpoint."""
    names: dict[str, None] = {}
    files = [path for folder in folders if folder.is_dir() for path in sorted(folder.glob("*.json"))]
    for path in [path for path in files if path.name not in _OWN_FILES][:_MOST_FILES]:
        if path.stat().st_size <= _MOST_BYTES:
            try:
                names.update(dict.fromkeys(_input_names(json_text.parse(path.read_text(encoding="utf-8")))))
            except (OSError, ValueError, RecursionError):
                continue
    return list(names)


def _input_names(value: Any) -> Iterator[str]:
    """Yield keys of maps, and texts of lists, that may name an input."""
    if isinstance(value, dict):
        yield from (key for key, item in value.items() if isinstance(item, (dict, list)) and _INPUT.fullmatch(key))
        for item in value.values():
            yield from _input_names(item)
    elif isinstance(value, list):
        for item in value:
            if isinstance(item, str) and _INPUT.fullmatch(item):
                yield item
            elif isinstance(item, (dict, list)):
                yield from _input_names(item)


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
