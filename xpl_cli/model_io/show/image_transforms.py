"""Detection of how an image that a model gets differs from the camera's: rotated, mirrored, red and blue swapped."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from xpl.convert import ConversionError
from xpl.convert.images import ImageInput

if TYPE_CHECKING:
    from xpl.contract import Entry

_GEOMETRY = frozenset(("resize", "letterbox", "crop"))
_CLEARER = 0.7
"""Share of the plain picture's difference above which no transform is reported: a symmetrical picture is ambiguous."""
_LEAST = 2.0
"""Mean difference, of 255, below which pictures are alike."""


def describe_transform(image: np.ndarray, camera: np.ndarray, entry: Entry) -> list[str]:
    """Return what lies between a camera's picture and what a model gets of it; [] if nothing does.

    Args:
        image: (h, w, 3) uint8, as it is shown to people.
        camera: (H, W, 3) uint8 RGB.
        entry: of `images` in the model_io block, whose scaling and cutting is no difference.
    """
    return nearest_transform(image, camera, entry)[0]


def nearest_transform(image: np.ndarray, camera: np.ndarray, entry: Entry | None = None) -> tuple[list[str], float]:
    """Return what lies between a camera's picture and another, as `exchanged`, and what is left then, 0 to 255."""
    errors = {words: difference(image, made, entry or {}) for words, made in _made(camera).items()}
    words = min(errors, key=lambda name: errors[name])
    plain = errors[()]
    return ([], plain) if errors[words] > _CLEARER * plain or plain < _LEAST else (list(words), errors[words])


def difference(image: np.ndarray, camera: np.ndarray, entry: Entry) -> float:
    """Return the mean difference, 0 to 255, between a picture and what scaling and cutting makes of a camera's."""
    steps = [step for step in entry.get("steps", ()) if next(iter(step)) in _GEOMETRY]
    plain = {"input": "", "cameras": [""], "steps": steps, "channels": "rgb", "layout": "hwc", "dtype": "uint8"}
    try:
        made = ImageInput(plain).view(camera)
    except ConversionError:  # larger than what it is cut out of
        return float("inf")
    if made.shape != image.shape:
        made = _stretched(made, image.shape[0], image.shape[1])
    return float(np.abs(made.astype(np.float32) - image).mean())


def _made(camera: np.ndarray) -> dict[tuple[str, ...], np.ndarray]:
    """Return the camera's picture in each way in which it may have been turned, mirrored and recoloured."""
    result = {}
    for colours, (turned, angle) in itertools.product((False, True), enumerate(("", "90", "180", "270"))):
        for is_mirrored in (False, True):
            made = np.rot90(camera, turned)
            made = made[:, ::-1] if is_mirrored else made
            made = made[..., ::-1] if colours else made
            words = [
                *(["upside down and mirrored"] if angle == "180" and is_mirrored else []),
                *(["mirrored"] if is_mirrored and angle != "180" else []),
                *([f"turned by {angle} degrees"] if angle and not (angle == "180" and is_mirrored) else []),
                *(["red and blue exchanged"] if colours else []),
            ]
            result[tuple(words)] = made
    return result


def _stretched(values: np.ndarray, height: int, width: int) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.fromarray(np.ascontiguousarray(values)).resize((width, height)))
