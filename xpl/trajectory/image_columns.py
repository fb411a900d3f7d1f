"""Columns of images: pixels, depth, or encoded images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import image_codec as codec
from xpl.observation import is_encoded
from xpl.trajectory.columns import ROWS, WAITING_BYTES, NumericColumn
from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.storage import hdf5

if TYPE_CHECKING:
    from xpl.trajectory import names
    from xpl.trajectory.hdf5_types import HDF5Group


class PixelColumn(NumericColumn):
    """Colour images as pixels (T, H, W, 3)."""

    def convert(self, value: Any) -> np.ndarray:
        """Return an image (H, W, 3) uint8, decoded if necessary."""
        return super().convert(decode_if_encoded(value))


class DepthColumn(NumericColumn):
    """Depth (T, H, W)."""

    def convert(self, value: Any) -> np.ndarray:
        """Return depth (H, W) of (H, W) or (H, W, 1)."""
        return super().convert(squeeze_depth(value))


class EncodedColumn:
    """Encoded colour images: a dataset (T,) of bytes of variable length, or (T, N) padded with NUL.

    Args:
        file: an open HDF5 file.
        path: path of the dataset.
        encode: returns the bytes of an image (H, W, 3) uint8 RGB.
        size: (height, width) of all images.
        padded: store (T, N) instead of (T,).
    """

    def __init__(
        self,
        file: HDF5Group,
        path: names.DatasetPath,
        encode: Callable[[Any], bytes],
        size: tuple[int, int],
        *,
        padded: bool,
    ) -> None:
        self._name, self._encode, self._size, self._padded = "/".join(path), encode, size, padded
        self._waiting: list[np.ndarray] = []
        if padded:  # compressed, so that the padding costs nothing
            options = {"dtype": np.uint8, "compression": "gzip", "compression_opts": 1}
            self._dataset = file.create_dataset(
                self._name, (0, 1), maxshape=(None, None), chunks=(1, 1 << 14), **options
            )
        else:
            kind = hdf5().vlen_dtype(np.uint8)
            self._dataset = file.create_dataset(self._name, (0,), maxshape=(None,), chunks=(ROWS,), dtype=kind)

    def convert(self, value: Any) -> bytes:
        """Return the stored bytes of an image.

        Raises:
            TrajectoryError: its size differs from the first one's.
        """
        if is_encoded(value):
            return bytes(value)
        image = np.asarray(value)
        if image.shape[:2] != self._size:
            raise TrajectoryError(f"{self._name}: expected images of {self._size}, got {image.shape}")
        return self._encode(image)

    def add(self, value: bytes) -> None:
        """Add the image of the next step."""
        self._waiting.append(np.frombuffer(value, np.uint8))
        if sum(map(len, self._waiting)) > WAITING_BYTES or len(self._waiting) >= ROWS:
            self.close()

    def close(self) -> None:
        """Write the buffered images."""
        if not self._waiting:
            return
        start, count = self._dataset.shape[0], len(self._waiting)
        if self._padded:
            self._dataset.resize((start + count, max(self._dataset.shape[1], *map(len, self._waiting))))
        else:
            self._dataset.resize(start + count, axis=0)
        for number, blob in enumerate(self._waiting, start):  # one by one: h5py would store equal lengths as a table
            self._dataset[(number, slice(len(blob))) if self._padded else number] = blob
        self._waiting = []


def decode_if_encoded(value: Any) -> np.ndarray:
    """Return the pixels of an image, decoded if necessary."""
    return codec.decode(value) if is_encoded(value) else np.asarray(value)


def squeeze_depth(value: Any) -> np.ndarray:
    """Return depth (H, W) of (H, W) or (H, W, 1)."""
    depth = np.asarray(value)
    return depth[:, :, 0] if depth.ndim == 3 and depth.shape[2] == 1 else depth
