"""Size of images, and how they get it: stretched, letterboxed with what fill, cropped.

Source: spec/v1/model_io.schema.json#/$defs/step.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import AdapterCase, Convention, GeometryStep, Mistake, image_changes
from xpl.catalogue.edits import Block, mistakes_at_sites
from xpl.catalogue.image_changes import (
    Steps,
    StepsChange,
    change_steps,
    prepend_step,
    remove_steps,
    replace_steps,
    set_in_steps,
)
from xpl.conventions.image_filter import FILTERS
from xpl.errors import ConversionError
from xpl.image_resize import resize

if TYPE_CHECKING:
    from xpl.contract import Entry

_NAME = "image_size"

FRACTIONS = (0.9, 0.95, 0.875, 0.8, 0.85, 0.9**0.5)
"""Of height and width that evaluation cuts out: 0.95 GR00T, 0.875 ImageNet's 224 of 256, 0.9 ** 0.5 OpenVLA's nine
tenths of the area; the likeliest first."""

BOXES: tuple[tuple[int, dict[str, Any]], ...] = (
    (0, {}),
    (1, {"anchor": "bottom_right"}),
    (1, {"anchor": "top_left"}),
    (2, {"fill": 127}),
    (2, {"fill": 128}),
    (2, {"fill": 255}),
)
"""Frames of a letterbox, by likelihood: openpi's, SmolVLA's at the lower right, grey and white ones."""

# -- there and back ----------------------------------------------------------------------------------------------------


def _cropped(how: Entry, shape: tuple[int, int]) -> tuple[int, int]:
    if "to" in how:
        height, width = how["to"]
    else:
        height, width = (int(size * how["fraction"]) for size in shape)
    if height > shape[0] or width > shape[1]:
        raise ConversionError(
            f"a crop to {height}x{width} of an image of {shape[0]}x{shape[1]}; crop less, or resize it before"
        )
    if not (height and width):
        raise ConversionError(f"a crop leaves nothing of an image of {shape[0]}x{shape[1]}; say a larger fraction")
    return int(height), int(width)


def _resampled(values: np.ndarray, how: Entry, height: int, width: int) -> np.ndarray:
    as_bytes = how.get("as", "uint8") == "uint8"
    return resize(values, (height, width), how["filter"], antialias=how.get("antialias", False), as_bytes=as_bytes)


def _letterboxed(values: np.ndarray, how: Entry) -> np.ndarray:
    height, width = how["to"]
    rows, columns, top, left = _frame(values.shape[:2], how)
    frame = np.full((height, width, values.shape[2]), how.get("fill", 0), np.float32)
    inner = _resampled(values, how, rows, columns)
    frame[top : top + rows, left : left + columns] = inner
    return frame.astype(inner.dtype)


def _frame(shape: tuple[int, ...], how: Entry) -> tuple[int, int, int, int]:
    """Return height, width, first row and first column of the image in its frame."""
    (height, width), anchor = how["to"], how.get("anchor", "center")
    # As written by the authors: multiplied by the inverse, one pixel is lost for other sizes than for them.
    ratio = max(shape[1] / width, shape[0] / height)
    rows, columns = int(shape[0] / ratio), int(shape[1] / ratio)
    if not (rows and columns):
        raise ConversionError(f"nothing is left of an image of {shape[0]}x{shape[1]} in a frame of {height}x{width}")
    free = height - rows, width - columns
    if anchor == "center":
        return rows, columns, free[0] // 2, free[1] // 2
    return (rows, columns, *free) if anchor == "bottom_right" else (rows, columns, 0, 0)


def _crop(values: np.ndarray, how: Entry) -> np.ndarray:
    height, width = _cropped(how, values.shape[:2])
    top, left = (values.shape[0] - height) // 2, (values.shape[1] - width) // 2
    return values[top : top + height, left : left + width]


def _uncropped(values: np.ndarray, _how: object, before: tuple[int, int]) -> np.ndarray:
    result = np.zeros((*before, values.shape[2]), values.dtype)
    top, left = (before[0] - values.shape[0]) // 2, (before[1] - values.shape[1]) // 2
    result[top : top + values.shape[0], left : left + values.shape[1]] = values
    return result


def _unboxed(values: np.ndarray, how: Entry, before: tuple[int, int]) -> np.ndarray:
    rows, columns, top, left = _frame(before, how)
    return _resampled(values[top : top + rows, left : left + columns], {**how, "as": "uint8"}, *before)


def _to(how: Entry, _before: object) -> tuple[int, int]:
    return int(how["to"][0]), int(how["to"][1])


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = image_changes.sites(case.block)
    yield from mistakes_at_sites(
        sites, 1, "resize instead of letterbox", _NAME, change_steps(_replace_step("letterbox", "resize"))
    )
    for rank, box in BOXES:
        change = change_steps(_replace_step("resize", "letterbox", box))
        yield from mistakes_at_sites(sites, 1 + rank, f"letterbox instead of resize{_format_box(box)}", _NAME, change)
    for word in ("crop", "resize", "letterbox"):  # which the model does itself
        yield from mistakes_at_sites(sites, 1, f"no {word}", _NAME, change_steps(remove_steps(word)))
    for fraction in FRACTIONS:
        crop = {"crop": {"fraction": fraction}}
        label = f"crop: {{fraction: {fraction:.6g}}}"
        yield from mistakes_at_sites(sites, 3, f"{label} first", _NAME, change_steps(prepend_step(crop)))
        yield from mistakes_at_sites(sites, 2, label, _NAME, change_steps(replace_steps("crop", crop)))
    for anchor in ("center", "bottom_right", "top_left"):
        edit = change_steps(set_in_steps(("letterbox",), "anchor", anchor, "center"))
        yield from mistakes_at_sites(sites, 2, f"anchor: {anchor}", _NAME, edit)
    for fill in (0, 114, *(box["fill"] for _, box in BOXES if "fill" in box)):
        edit = change_steps(set_in_steps(("letterbox",), "fill", fill, 0))
        yield from mistakes_at_sites(sites, 2, f"fill: {fill}", _NAME, edit)
    yield from mistakes_at_sites(sites, 1, "to: height and width exchanged", _NAME, _swap_height_and_width)
    yield from mistakes_at_sites(sites, 3, "steps in the other order", _NAME, change_steps(lambda steps: steps[::-1]))


def _format_box(box: Entry) -> str:
    return "".join(f", {key}: {value}" for key, value in box.items())


def _swap_height_and_width(entry: Block) -> Block | None:
    """Exchange height and width of the size that the model reads."""
    steps = [
        {word: {**how, "to": how["to"][::-1]} if isinstance(how, Mapping) and "to" in how else how}
        for step in entry.get("steps", ())
        for word, how in step.items()
    ]
    return {"steps": steps} if steps != list(entry.get("steps", ())) else None


def _replace_step(one: str, other: str, more: Block | None = None) -> StepsChange:
    common_keys = {"to", "filter", "antialias", "as"}

    def change(steps: Steps) -> Steps:
        return [
            {other: {**{key: value for key, value in step[one].items() if key in common_keys}, **(more or {})}}
            if one in step
            else step
            for step in steps
        ]

    return change


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for how in ("padded", "cropped", "stretched"):
        yield from image_changes.image_mistakes(1, f"{how} to a square", _NAME, partial(_make_square, how=how), case)
    if not case.cameras:
        return
    for model_fraction, adapter_fraction in itertools.permutations((1, *FRACTIONS), 2):
        label = "no crop" if model_fraction == 1 else f"crop: {model_fraction:.6g}"
        words = label if adapter_fraction == 1 else f"{label}, not {adapter_fraction:.6g}"
        change = image_changes.change_images(
            partial(_recrop, model_fraction=model_fraction, adapter_fraction=adapter_fraction), case.cameras
        )
        yield Mistake(2, words, _NAME, change_observations=change)


def _make_square(picture: np.ndarray, *, how: str) -> np.ndarray:
    height, width = picture.shape[:2]
    if how == "cropped":
        return _crop(picture, {"to": [min(height, width)] * 2})
    side = max(height, width)
    if how == "stretched":
        return resize(picture, (side, side), "bilinear")
    return _uncropped(picture, None, (side, side))


def _recrop(picture: np.ndarray, *, model_fraction: float, adapter_fraction: float) -> np.ndarray:
    """Return a picture whose middle, as much as the adapter cuts out, is the middle that the model should see."""
    crop = _crop(picture, {"fraction": model_fraction})
    height, width = (int(np.ceil(size / adapter_fraction)) for size in crop.shape[:2])
    return _uncropped(crop, None, (height, width))


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for number, (kind, antialias) in enumerate(FILTERS if case.cameras else ()):
        words = f"filter: {kind}" + (", antialias" if antialias and kind != "lanczos" else "")
        how = {"filter": kind, "antialias": antialias}
        made: list[tuple[int, str, list[dict[str, Any]]]] = [(0, "resize", [{"resize": how}])]
        made += [(rank, f"letterbox{_format_box(box)}", [{"letterbox": {**how, **box}}]) for rank, box in BOXES]
        made += [
            (2, f"crop to {part:.6g}, resize", [{"crop": {"fraction": part}}, {"resize": how}]) for part in FRACTIONS
        ]
        made += [(1, "the middle square, resize", [{"square": {}}, {"resize": how}])]
        exchanged = {"kind": "resized", "steps": [{"resize": how}], "exchanged": True}
        label = f"resize, height and width exchanged, {words}"
        yield Mistake(1 + (number > 3), label, _NAME, input_change=exchanged, geometry="exchanged")
        for rank, geometry, steps in made:
            extra_rank = 1 if rank and number > 3 else 0
            encoded = {"kind": "resized", "steps": steps}
            yield Mistake(rank + extra_rank, f"{geometry}, {words}", _NAME, input_change=encoded, geometry=geometry)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    keys={"images": ["steps"], "steps": ["resize", "letterbox", "crop", "to", "fill", "anchor", "fraction"]},
    applies=lambda block: bool(block.get("images")),
    steps={
        "resize": GeometryStep(
            lambda values, how: _resampled(values, how, *how["to"]),
            lambda values, how, before: _resampled(values, {**how, "as": "uint8"}, *before),
            _to,
        ),
        "letterbox": GeometryStep(_letterboxed, _unboxed, _to),
        "crop": GeometryStep(_crop, _uncropped, _cropped),
    },
)
