"""Test images in which every mistake shows: fine detail, no symmetry, unlike channels, distinct edges.

Integers only, so that every machine makes the same bytes.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LEVELS = 128
"""Values that the pattern has; what a moment adds to it lies below the rest of a byte."""
_ADDED = ((37, 11, 127), (59, 71, 113), (83, 29, 109))
"""By channel: what each moment and each camera adds, modulo a prime below the rest of a byte."""
_EDGE = 16
"""Share of a side that its bright edge has: one of so many."""


def test_image(camera: int, moment: int, height: int, width: int) -> NDArray[np.uint8]:
    """Return what a camera sees at a moment, (height, width, 3) uint8 RGB.

    Args:
        camera: number of the camera.
        moment: any number; each has another picture.
        height: pixels.
        width: pixels.
    """
    added = np.array([(moment * one + camera * other) % prime for one, other, prime in _ADDED], np.uint8)
    rows = _pattern(camera, height, width).reshape(height, -1) + np.tile(added, width)  # rows add faster than pixels
    image = rows.reshape(height, width, -1)
    top, left = _corner(moment, height, 5), _corner(moment + camera, width, 7)
    image[top : top + max(1, height // 6), left : left + max(1, width // 8)] = (250, 20 + 40 * (camera % 4), 90)
    return image


def _corner(moment: int, size: int, stride: int) -> int:
    """Return where a mark that moves begins."""
    return (moment * stride * size // 64) % max(1, size - size // 4)


@cache
def _pattern(camera: int, height: int, width: int) -> NDArray[np.uint8]:
    """Return what a camera sees at every moment, below `_LEVELS`; read-only."""
    rows, columns = np.mgrid[0:height, 0:width].astype(np.uint32)
    red = 8 + 80 * columns // width  # brighter to the right
    green = 16 + 48 * rows // height + 24 * ((rows ^ columns) & 1)  # darker above, and a chequerboard of single pixels
    blue = 12 + 64 * ((3 * columns + 5 * rows) % 97 < 23 + 9 * (camera % 3))  # slanted stripes
    channels = [red, green, blue]
    channels = channels[camera % 3 :] + channels[: camera % 3]  # no camera is like another one
    image = np.stack(
        [
            np.minimum(one + _noise(rows, columns, 3 * camera + channel), _LEVELS - 1)
            for channel, one in enumerate(channels)
        ],
        axis=-1,
    ).astype(np.uint8)
    image[: max(1, height // _EDGE)] //= 4
    image[:, : max(1, width // _EDGE)] |= np.array([96, 0, 32], np.uint8)
    image[-max(1, height // (2 * _EDGE)) :] |= np.array([0, 64, 96], np.uint8)
    image.flags.writeable = False
    return image


def _noise(rows: Any, columns: Any, seed: int) -> Any:
    """Return detail of single pixels, 0..31: an integer hash of their places (Murmur's finaliser)."""
    value = rows * np.uint32(0x9E3779B1) ^ columns * np.uint32(0x85EBCA77) ^ np.uint32(seed * 0x27D4EB2F & 0xFFFFFFFF)
    value ^= value >> np.uint32(15)
    value *= np.uint32(0x2C1B3C6D)
    value ^= value >> np.uint32(12)
    return value & np.uint32(31)
