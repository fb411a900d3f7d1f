"""Order of colours. Source: spec/v1/model_io.schema.json#/$defs/channels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import Case, Convention, Mistake, Stage, pictures, walk
from xpl.catalogue.edits import everywhere, word

if TYPE_CHECKING:
    from collections.abc import Iterator

_NAME = "image_channels"


def ordered(values: np.ndarray, channels: str) -> np.ndarray:
    """Return images (..., 3) of red, green and blue in the order of `channels`: rgb or bgr; its own inverse."""
    return values[..., ::-1] if channels == "bgr" else values


def _in_block(case: Case) -> Iterator[Mistake]:
    for colours in ("bgr", "rgb"):
        yield from everywhere(pictures.sites(case.block), 0, f"channels: {colours}", _NAME, word("channels", colours))


def _around(case: Case) -> Iterator[Mistake]:
    yield from pictures.shown(0, "channels: red and blue exchanged", _NAME, lambda one: ordered(one, "bgr"), case)


def _in_inputs(case: Case) -> Iterator[Mistake]:
    if case.cameras:
        yield Mistake(0, "channels: red and blue exchanged", _NAME, encoded={"kind": "colours"})


def _exchanged(value: Any, _how: object) -> Any:
    return walk.pictures(value, lambda array, axis: np.ascontiguousarray(np.flip(array, axis)))


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    in_inputs=_in_inputs,
    kinds={"colours": _exchanged},
    images={"channels": Stage(ordered, ordered)},
    keys={"images": ["channels"]},
)
