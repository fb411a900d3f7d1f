"""Image datasets of a file: detection by name and content, size from the header, decoding one by one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import image_codec as codec
from xpl.observation import ObservationError
from xpl.trajectory import names, storage
from xpl.trajectory.errors import TrajectoryError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from xpl.trajectory.hdf5_types import HDF5Dataset
    from xpl.trajectory.names import DatasetPath

COLOR, DEPTH = spec.Camera.COLOR, spec.Camera.DEPTH
_BEGINS = {b"\xff\xd8\xff": "jpeg", b"\x89PNG\r\n\x1a\n": "png"}
_MOST_ENCODED = 1 << 26
"""Bytes of a row that may be an encoded image, its padding included."""
_SMALLEST = 8
"""Pixels of the smallest image that is taken for one where the standard does not know its name."""


@dataclass(frozen=True)
class ImageSeries:
    """Images of a dataset, one per step.

    Attributes:
        height: in pixels.
        width: in pixels.
        kind: `color`, (H, W, 3) uint8 RGB, or `depth`, (H, W) as stored.
        encoding: storage: `raw`, `jpeg`, `png`, or `other` decodable format.
    """

    height: int
    width: int
    kind: str
    encoding: str = "raw"


def image_series(path: DatasetPath, dataset: HDF5Dataset) -> ImageSeries | None:
    """Return the images of a dataset with one row per step; None if it has none.

    Raises:
        TrajectoryError: its name says that it holds some, and the first is none; or they are larger than is read.
    """
    shape = dataset.shape
    is_named = names.is_image(path, COLOR, DEPTH)
    least = 1 if is_named else _SMALLEST
    picture = None
    if len(shape) == 4 and dataset.dtype == np.uint8 and shape[3] == 3 and min(shape[1:3]) >= least:
        picture = ImageSeries(shape[1], shape[2], COLOR)
    elif _is_depth(path, dataset) and min(shape[1:3]) >= least:
        picture = ImageSeries(shape[1], shape[2], DEPTH)
    elif shape[:1] != (0,) and _may_be_encoded(dataset):
        data = read_row(dataset, 0)
        encoding = next((name for begins, name in _BEGINS.items() if data.startswith(begins)), None)
        if encoding is not None or is_named:
            width, height = _size(dataset, data)
            picture = ImageSeries(height, width, COLOR, encoding or "other")
    if picture is not None and picture.height * picture.width > codec.PIXELS:
        raise TrajectoryError(
            f"{storage.describe(dataset)}: images have {shape[1:3]} pixels, more than {codec.PIXELS} in all"
        )
    return picture


def read_encoded(dataset: HDF5Dataset, steps: Iterable[int]) -> Iterator[tuple[int, bytes]]:
    """Yield steps with their encoded images, as `encoded` returns them.

    Raises:
        TrajectoryError: one cannot be read, or they are more than the file can hold, because they are one another.
    """
    most = storage.most_read(Path(dataset.file.filename).stat().st_size)
    for step in steps:
        data = read_row(dataset, step)
        most -= len(data)
        if most < 0:
            raise TrajectoryError(
                f"{storage.describe(dataset)}: up to step {step} images claim more than the file holds"
            )
        yield step, data


def read_decoded(dataset: HDF5Dataset, step: int) -> np.ndarray:
    """Return an encoded image, (H, W, 3) uint8 RGB.

    Raises:
        TrajectoryError: it cannot be decoded; the text says which.
    """
    return decode_row(dataset, step, read_row(dataset, step))


def decode_row(dataset: HDF5Dataset, step: int, data: bytes) -> np.ndarray:
    """Decode an encoded image.

    Args:
        dataset: its dataset, for errors.
        step: its step, for errors.
        data: the encoded image.

    Returns:
        (H, W, 3) uint8 RGB.

    Raises:
        TrajectoryError: it cannot be decoded.
    """
    try:
        return codec.decode(data)
    except (ObservationError, ValueError) as error:
        raise TrajectoryError(f"{storage.describe(dataset)}, step {step}: {error}") from None


def read_row(dataset: HDF5Dataset, step: int) -> bytes:
    """Return an encoded image as it lies in the file, padding included.

    Raises:
        TrajectoryError: it cannot be read.
    """
    try:
        data = dataset[step]
    except (OSError, RuntimeError, ValueError) as error:
        raise TrajectoryError(f"{storage.describe(dataset)}, step {step} cannot be read: {error}") from None
    return data if isinstance(data, bytes) else np.asarray(data, np.uint8).tobytes()


def _is_depth(path: DatasetPath, dataset: HDF5Dataset) -> bool:
    shape = dataset.shape
    is_flat = len(shape) == 3 or (len(shape) == 4 and shape[3] == 1)
    is_called_so = names.is_image(path, DEPTH) or DEPTH in "/".join(path).lower()
    return is_flat and is_called_so and dataset.dtype.kind in "uf"


def _may_be_encoded(dataset: HDF5Dataset) -> bool:
    library = storage.hdf5()
    if not storage.is_encoded(dataset):
        return False
    if dataset.dtype.kind != "O" and storage.size_of(dataset, 0) > _MOST_ENCODED:
        return False
    is_bytes = library.check_vlen_dtype(dataset.dtype) == np.uint8
    return bool(dataset.dtype.kind != "O" or is_bytes or library.check_string_dtype(dataset.dtype) is not None)


def _size(dataset: HDF5Dataset, data: bytes) -> tuple[int, int]:
    try:
        return codec.size_of(data)
    except ObservationError as error:
        raise TrajectoryError(f"{storage.describe(dataset)}, step 0: {error}") from None
