"""Changes of how encoded images were resized."""

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
"""Fractions of an image that an adapter may crop."""


def sizes(value: object) -> list[tuple[int, int]]:
    """Return height and width of one camera's image in encoded inputs, each once; images that are joined are split."""
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
    """Return the steps of a geometry with their sizes for an image of one shape.

    Args:
        steps: steps of a model_io block, without `to`; `square` crops the middle.
        size: height and width after a resize or a letterbox, pixels.
        shape: height and width of the image, pixels; further axes are not read.
    """
    images = []
    for step in steps:
        for kind, how in step.items():
            if kind == "square":
                images.append({"crop": {"to": [min(shape[:2])] * 2}})
            else:
                images.append({kind: {**how, "to": list(size)} if kind in ("resize", "letterbox") else how})
    return images


class ResizedInputs:
    """Resizes images to the model's size before the adapter does, so that the adapter's resize has no effect.

    Args:
        encode: the adapter's `encode`.
        sample: an observation.

    Raises:
        NoEffectError: the adapter changes the pixels of images that have the model's size.
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
        """Return an observation with resized images; steps are those of a model_io block, without `to`."""
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
        """Return a larger image, black around this one, from which the adapter's crop cuts this one."""
        size = np.array(view.shape[:2])
        whole = np.ceil(size / self._cut).astype(int)
        top, left = (whole - size) // 2
        frame = np.zeros((*whole, view.shape[2]), view.dtype)
        frame[top : top + size[0], left : left + size[1]] = view
        return frame

    def _is_seen_through(self, encode: EncodeOne, sample: Observation) -> bool:
        """Return whether the encoded images have the pixels of the observed ones, scaled, in any order."""
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
    """Return whether each channel (..., 3) has each level equally often, up to a scale and an offset."""
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
    """Return the largest distance of the images of two encoded values: mean absolute difference over range."""
    first, second = ([array for array in leaves(value) if channel_axis(array) is not None] for value in (one, other))
    if [array.shape for array in first] != [array.shape for array in second]:
        return float("inf")
    far = [np.abs(a.astype(np.float64) - b).mean() / (float(np.ptp(a)) or 1.0) for a, b in zip(first, second)]
    return float(max(far, default=0.0))
