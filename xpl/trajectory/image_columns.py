"""Columns of images: as pixels, as depth, or encoded one by one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import images as codec
from xpl.observation import is_encoded
from xpl.trajectory.columns import Blobs, Rows
from xpl.trajectory.errors import TrajectoryError

if TYPE_CHECKING:
    from xpl.trajectory import names


class Pixels(Rows):
    """Colour images as pixels (T, H, W, 3)."""

    def fitting(self, value: Any) -> np.ndarray:
        """Return an image, (H, W, 3) uint8, of one that may be encoded."""
        return super().fitting(decoded(value))


class Depth(Rows):
    """Depth (T, H, W)."""

    def fitting(self, value: Any) -> np.ndarray:
        """Return depth (H, W) of (H, W) or (H, W, 1)."""
        return super().fitting(flat(value))


class Encoded:
    """Colour images, encoded."""

    def __init__(self, blobs: Blobs, encode: Callable[[Any], bytes], size: tuple[int, int], path: names.Place) -> None:
        self._blobs, self._encode, self._size, self._path = blobs, encode, size, path

    def fitting(self, value: Any) -> bytes:
        """Return an image as it is stored.

        Raises:
            TrajectoryError: it has another size than the first one.
        """
        if is_encoded(value):
            return bytes(value)
        image = np.asarray(value)
        if image.shape[:2] != self._size:
            raise TrajectoryError(f"{'/'.join(self._path)}: expected images of {self._size}, got {image.shape}")
        return self._encode(image)

    def add(self, value: bytes) -> None:
        """Take the image of the next step."""
        self._blobs.add(value)

    def close(self) -> None:
        """Write what is still in memory."""
        self._blobs.close()


def decoded(value: Any) -> np.ndarray:
    """Return the pixels of an image that may be encoded."""
    return codec.decode(value) if is_encoded(value) else np.asarray(value)


def flat(value: Any) -> np.ndarray:
    """Return depth (H, W) of (H, W) or (H, W, 1)."""
    depth = np.asarray(value)
    return depth[:, :, 0] if depth.ndim == 3 and depth.shape[2] == 1 else depth
