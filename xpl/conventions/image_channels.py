"""Order of colours. Source: spec/v1/model_io.schema.json#/$defs/channels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import AdapterCase, Convention, Mistake, ValueTransform, image_changes, walk
from xpl.catalogue.edits import mistakes_at_sites, set_key

if TYPE_CHECKING:
    from collections.abc import Iterator

_NAME = "image_channels"


def reorder_channels(values: np.ndarray, channels: str) -> np.ndarray:
    """Return images (..., 3) of red, green and blue in the order of `channels`: rgb or bgr; its own inverse."""
    return values[..., ::-1] if channels == "bgr" else values


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for colours in ("bgr", "rgb"):
        yield from mistakes_at_sites(
            image_changes.sites(case.block), 0, f"channels: {colours}", _NAME, set_key("channels", colours)
        )


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    yield from image_changes.image_mistakes(
        0, "channels: red and blue exchanged", _NAME, lambda one: reorder_channels(one, "bgr"), case
    )


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if case.cameras:
        yield Mistake(0, "channels: red and blue exchanged", _NAME, input_change={"kind": "colours"})


def _swap_red_and_blue(value: Any, _how: object) -> Any:
    return walk.map_images(value, lambda array, axis: np.ascontiguousarray(np.flip(array, axis)))


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    input_changes={"colours": _swap_red_and_blue},
    images={"channels": ValueTransform(reorder_channels, reorder_channels)},
    keys={"images": ["channels"]},
)
