"""Numbers of pixels: range, mean and std, and the layout of axes. Source: spec/v1/model_io.schema.json, `images`."""

from __future__ import annotations

import itertools
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.catalogue import AdapterCase, Convention, Mistake, image_changes, walk
from xpl.catalogue.edits import REMOVE, Block, EntryChange, mistakes_at_sites
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Entry

_NAME = "image_range"
_BYTES = 255.0

MEANS: Mapping[str, tuple[list[float], list[float]]] = {
    "ImageNet's": ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]),
    "CLIP's": ([0.48145466, 0.4578275, 0.40821073], [0.26862954, 0.26130258, 0.27577711]),
    "0.5": ([0.5, 0.5, 0.5], [0.5, 0.5, 0.5]),
}
"""Mean and standard deviation by channel, red first, as models were met with them: torchvision's, OpenAI CLIP's, and
SigLIP's, which is the range from -1 to 1."""

RANGES: tuple[tuple[int, list[float]], ...] = (
    (0, [0, 1]),
    (0, [-1, 1]),
    (1, [0, 255]),
    (2, [-0.5, 0.5]),
)
"""By likelihood, what 0 and 255 become."""


class PixelScaling:
    """Bytes as the numbers of an image input.

    Args:
        entry: of `images` in the block.
        where: how errors call it.

    Attributes:
        is_bytes: they stay bytes; else float32.
        low, span: `bytes * span / 255 + low`, then `mean` is taken off and `std` divided by; float32. A product with
            1 / 255 would differ from this quotient, which torchvision, LeRobot and openpi compute, in the last digit.

    Raises:
        ConversionError: if they are no numbers of images.
    """

    def __init__(self, entry: Entry, where: str) -> None:
        self.is_bytes = entry["dtype"] == "uint8"
        low, high = entry.get("range", (0.0, 1.0))
        self.low, self.span = np.float32(low), np.float32(high - low)
        self.mean = np.asarray(entry.get("mean", 0.0), np.float32)
        self.std = np.asarray(entry.get("std", 1.0), np.float32)
        if self.is_bytes and not {"range", "mean", "std"}.isdisjoint(entry):
            raise ConversionError(
                f"{where}: bytes have neither range nor mean and std; say dtype: float32, or leave them out"
            )
        if not self.span:
            raise ConversionError(f"{where}: range is {low} at both ends; say what 0 and 255 become")
        if (self.std == 0).any():
            raise ConversionError(f"{where}: std holds a zero, and images are divided by it; give each channel's own")

    def encode(self, values: np.ndarray) -> np.ndarray:
        """Return the model's numbers of images (..., 3), 0 to 255."""
        if self.is_bytes:
            return as_bytes(values)
        result: np.ndarray = (values * self.span / np.float32(_BYTES) + self.low - self.mean) / self.std
        return result.astype(np.float32, copy=False)

    def decode(self, values: np.ndarray) -> np.ndarray:
        """Return images (..., 3), 0 to 255 and not rounded, of the model's numbers."""
        return values if self.is_bytes else (values * self.std + self.mean - self.low) * (_BYTES / self.span)


def as_bytes(values: np.ndarray) -> np.ndarray:
    """Return images (..., 3), 0 to 255, rounded to bytes."""
    return values if values.dtype == np.uint8 else np.clip(np.floor(values + 0.5), 0, _BYTES).astype(np.uint8)


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = image_changes.sites(case.block)
    for rank, span in RANGES:
        yield from mistakes_at_sites(sites, rank, f"range: {span}", _NAME, _set_range(span))
    yield from mistakes_at_sites(sites, 2, "dtype: uint8", _NAME, _as_bytes)
    yield from mistakes_at_sites(sites, 0, "mean and std: none", _NAME, _without_mean)
    for name, (mean, std) in MEANS.items():
        yield from mistakes_at_sites(sites, 1, f"mean and std: {name}", _NAME, _with_mean(mean, std))
    yield from mistakes_at_sites(sites, 2, "mean and std in the other order of channels", _NAME, _mean_reversed)


def _as_float(entry: Block) -> dict[str, Any]:
    return {} if entry["dtype"] == "float32" else {"dtype": "float32"}


def _as_bytes(entry: Block) -> Block | None:
    return None if entry["dtype"] == "uint8" else {"dtype": "uint8", "range": REMOVE, "mean": REMOVE, "std": REMOVE}


def _set_range(span: Sequence[float]) -> EntryChange:
    def change(entry: Block) -> Block | None:
        if entry["dtype"] == "float32" and list(entry.get("range", [0, 1])) == span:
            return None
        return {"range": REMOVE if span == [0, 1] else span, **_as_float(entry)}

    return change


def _without_mean(entry: Block) -> Block | None:
    return {"mean": REMOVE, "std": REMOVE} if {"mean", "std"} & set(entry) else None


def _with_mean(mean: Sequence[float], std: Sequence[float]) -> EntryChange:
    def change(entry: Block) -> Block | None:
        if (entry.get("mean"), entry.get("std")) == (mean, std):
            return None
        return {"mean": mean, "std": std, "range": REMOVE, **_as_float(entry)}

    return change


def _mean_reversed(entry: Block) -> Block | None:
    turned = {key: entry[key][::-1] for key in ("mean", "std") if key in entry}
    return turned if any(entry[key] != values for key, values in turned.items()) else None


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for words, scale, offset in (("0 to 1, not -1 to 1", 0.5, 127.5), ("-1 to 1, not 0 to 1", 2.0, -255.0)):
        yield from image_changes.image_mistakes(
            1, f"range: {words}", _NAME, partial(_linear, scale=scale, offset=offset), case
        )


def _linear(picture: np.ndarray, *, scale: float, offset: float) -> np.ndarray:
    return np.clip(np.rint(picture * scale + offset), 0, _BYTES).astype(np.uint8)


def _input_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if not case.cameras:
        return
    forms = [(rank, f"range: {span}", [[span[0]] * 3, [span[1]] * 3]) for rank, span in RANGES]
    forms.append((2, "range: [0, 1], divided by 255 once more", [[0.0] * 3, [1 / _BYTES] * 3]))
    of_bytes: list[tuple[int, str, list[list[float]]]] = []
    for name, (mean, std) in MEANS.items():
        if name == "0.5":  # which is the range from -1 to 1
            continue
        for label, order in (("", slice(None)), (", of the other order of channels", slice(None, None, -1))):
            ends = list(zip(mean[order], std[order]))
            black = [-one / other for one, other in ends]
            white, white_of_bytes = ([(most - one) / other for one, other in ends] for most in (1, _BYTES))
            forms.append((1 + bool(label), f"mean and std: {name}{label}", [black, white]))
            of_bytes.append((2, f"mean and std: {name}{label}, of 0 to 255", [black, white_of_bytes]))
    for (rank, words, to), (other_rank, other, of) in [
        *itertools.permutations(forms, 2),
        *itertools.product(forms, of_bytes),
    ]:
        label = other[len("range: ") :] if words.startswith("range: ") and other.startswith("range: ") else other
        how = {"kind": "scaled", "of": of, "to": to}
        yield Mistake(max(rank, other_rank), f"{words}, not {label}", _NAME, input_change=how)
    for layout in ("hwc", "chw"):
        yield Mistake(1, f"layout: {layout}", _NAME, input_change={"kind": "layout", "to": layout})


def _rescale(value: Any, how: Entry) -> Any:
    """Return pictures whose black and white are others.

    Args:
        value: encoded inputs.
        how: `of` and `to`: what black and white are by channel now, and what they become.

    Raises:
        NoEffectError: if the pictures cannot be of these numbers.
    """
    (black, white), (new_black, new_white) = (np.asarray(how[name], np.float64) for name in ("of", "to"))

    def change(array: Any, axis: int) -> Any:
        last = np.moveaxis(array, axis, -1).astype(np.float64)
        share = (last - black) / (white - black)
        if share.min() < -1e-3 or share.max() > 1.001 or np.ptp(share) < 0.25:
            raise walk.NoEffectError(f"pictures from {array.min():.3g} to {array.max():.3g}")
        return np.moveaxis(new_black + share * (new_white - new_black), -1, axis).astype(np.float32)

    return walk.map_images(value, change)


def _set_layout(value: Any, how: Entry) -> Any:
    """Return pictures whose axes are in another order: `to` is hwc or chw."""

    def change(array: Any, axis: int) -> Any:
        target_axis = -1 if how["to"] == "hwc" else -3
        return None if axis == target_axis else np.ascontiguousarray(np.moveaxis(array, axis, target_axis))

    return walk.map_images(value, change)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    input_mistakes=_input_mistakes,
    input_changes={"scaled": _rescale, "layout": _set_layout},
    keys={"images": ["layout", "dtype", "range", "mean", "std"]},
)
