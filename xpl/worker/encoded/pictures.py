"""Changes of how encoded pictures got their size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.catalogue.walk import EncodeOne, NoEffectError, channel_axis, leaves
from xpl.conventions.image_size import FRACTIONS
from xpl.convert.images import ImageInput
from xpl.observation import get_image

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Entry, Observation

_CROPS = (1.0, *FRACTIONS, 0.95**0.5, 0.8**0.5, 0.9**2, 0.8**2)
"""What an adapter may cut out of what it is shown."""


def sizes(value: object) -> list[tuple[int, int]]:
    """Return height and width of one camera's picture in encoded inputs, each once; two in one count by themselves."""
    image_sizes = []
    for array in leaves(value):
        axis = channel_axis(array)
        if axis is not None:
            height, width = (array.shape[one] for one in ((-3, -2) if axis == -1 else (-2, -1)))
            across = width // height if width in (2 * height, 3 * height) else 1
            down = height // width if height in (2 * width, 3 * width) else 1
            image_sizes.append((height // down, width // across))
    return list(dict.fromkeys(image_sizes))


def whole(steps: Sequence[Entry], size: Sequence[int], shape: Sequence[int]) -> list[dict[str, Any]]:
    """Return steps of a geometry with the sizes that a picture of a shape gets; `square` cuts out its middle."""
    images = []
    for step in steps:
        for kind, how in step.items():
            if kind == "square":
                images.append({"crop": {"to": [min(shape[:2])] * 2}})
            else:
                images.append({kind: {**how, "to": list(size)} if kind in ("resize", "letterbox") else how})
    return images


class ResizedInputs:
    """Shows pictures that already have the model's size, so that what the adapter does to the size has no effect.

    Args:
        encode: the adapter's.
        sample: an observation.

    Raises:
        NoEffectError: if it does not see through to the adapter's pictures: other sizes, other ways to cut them.
    """

    def __init__(self, encode: EncodeOne, sample: Observation) -> None:
        made = encode(sample)
        found = sizes(made)
        if not found:
            raise NoEffectError("no pictures")
        for self._size in found[:2]:
            for self._cut in _CROPS:
                if self._is_seen_through(encode, sample):
                    return
        raise NoEffectError("the adapter changes pictures that have the model's size")

    def __call__(self, obs: Observation, steps: Sequence[Entry]) -> dict[str, Any]:
        """Return an observation with such pictures; steps are a geometry in words of a model_io block, without `to`."""
        vision = obs[spec.Obs.VISION]
        entry = {"input": "", "channels": "rgb", "layout": "hwc", "dtype": "uint8"}
        seen = {}
        for camera, was in vision.items():
            image = get_image(obs, camera)
            made = whole(steps, self._size, image.shape)
            view = ImageInput({**entry, "cameras": [camera], "steps": made}).view(image)
            seen[camera] = {**was, spec.Camera.COLOR: self._framed(view)}
        return {**obs, spec.Obs.VISION: seen}

    def _framed(self, view: np.ndarray) -> np.ndarray:
        """Return a picture whose middle, as much as the adapter cuts out, is this one."""
        size = np.array(view.shape[:2])
        whole = np.ceil(size / self._cut).astype(int)
        top, left = (whole - size) // 2
        frame = np.zeros((*whole, view.shape[2]), view.dtype)
        frame[top : top + size[0], left : left + size[1]] = view
        return frame

    def _is_seen_through(self, encode: EncodeOne, sample: Observation) -> bool:
        """Tell whether the encoded pictures have the very pixels that were shown, scaled and in whatever place."""
        height, width = self._size
        levels = np.arange(height * width) * 256 // (height * width)
        rng = np.random.default_rng(0)
        probe = np.stack([rng.permutation(levels) for _ in range(3)], -1).reshape(height, width, 3).astype(np.uint8)
        vision = sample[spec.Obs.VISION]
        shown = {camera: {**was, spec.Camera.COLOR: self._framed(probe)} for camera, was in vision.items()}
        made = [
            array for array in leaves(encode({**sample, spec.Obs.VISION: shown})) if channel_axis(array) is not None
        ]
        return all(_has_levels(np.moveaxis(array, channel_axis(array) or -1, -1), levels) for array in made)


def _has_levels(array: np.ndarray, levels: np.ndarray) -> bool:
    """Tell whether each channel (..., 3) has each level equally often, but for a scale and an offset."""
    for channel in array.reshape(-1, 3).T.astype(np.float64):
        if channel.size % levels.size:
            return False
        expected = np.repeat(levels, channel.size // levels.size).astype(np.float64)
        levels_sorted = np.sort(channel)
        slope, offset = np.polyfit(expected, levels_sorted, 1)
        if np.abs(slope * expected + offset - levels_sorted).max() > 1e-3 * abs(slope) * 255:
            return False
    return True


def apart(one: object, other: object) -> float:
    """Return how far the pictures of two encoded values are apart: the mean of their differences, by their range."""
    first, second = ([array for array in leaves(value) if channel_axis(array) is not None] for value in (one, other))
    if [array.shape for array in first] != [array.shape for array in second]:
        return float("inf")
    far = [np.abs(a.astype(np.float64) - b).mean() / (float(np.ptp(a)) or 1.0) for a, b in zip(first, second)]
    return float(max(far, default=0.0))
