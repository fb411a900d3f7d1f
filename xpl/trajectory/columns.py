"""Columns of a file: datasets with one value per step, written in bounded memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.storage import LIST, PER_STEP, hdf5

if TYPE_CHECKING:
    from xpl.trajectory.hdf5_types import HDF5Group
    from xpl.trajectory.names import DatasetPath

ROWS = 64
"""Most values that are buffered, and rows of a chunk of small values."""
WAITING_BYTES = 1 << 22


class EpisodeColumn(Protocol):
    """A dataset with one value per step."""

    def convert(self, value: Any) -> Any:
        """Return the value of the next step in the form that `add` takes.

        Raises:
            TrajectoryError: it does not fit the earlier values.
        """

    def add(self, value: Any) -> None:
        """Add the converted value of the next step."""

    def close(self) -> None:
        """Write the buffered values."""


class NumericColumn:
    """Arrays of one shape and dtype: a dataset (T, *shape).

    Args:
        file: an open HDF5 file.
        path: path of the dataset.
        first: the first value; the others must have its shape and dtype.
        chunk: rows per chunk.
        marked: set the attribute that marks one row per step, for names that do not imply it.
        compression: options of h5py for the dataset.
    """

    def __init__(
        self,
        file: HDF5Group,
        path: DatasetPath,
        first: np.ndarray,
        chunk: int = ROWS,
        *,
        marked: bool = False,
        **compression: Any,
    ) -> None:
        self._name = "/".join(path)
        self._shape, self._dtype = first.shape, first.dtype
        self._most = max(1, min(ROWS, WAITING_BYTES // max(1, first.nbytes)))
        self._waiting: list[np.ndarray] = []
        # HDF5 needs chunks of at least one value; only a resizable dataset may have chunks larger than its size.
        sizes = {
            "shape": (0, *first.shape),
            "maxshape": (None, *(size or None for size in first.shape)),
            "chunks": (min(chunk, self._most), *(max(1, size) for size in first.shape)),
        }
        self._dataset = file.create_dataset(self._name, dtype=first.dtype, **sizes, **compression)
        if marked:
            self._dataset.attrs[PER_STEP] = True

    def convert(self, value: Any) -> np.ndarray:
        """Return a copy, because simulators reuse their arrays.

        Raises:
            TrajectoryError: its shape or dtype differs from the first one's.
        """
        array = numbers(value, self._name)
        if array.shape != self._shape or not np.can_cast(array.dtype, self._dtype, "same_kind"):
            step = self._dataset.shape[0] + len(self._waiting)
            raise TrajectoryError(
                f"{self._name}, step {step}: expected {self._shape} {self._dtype}, as the steps before it have, "
                f"got {array.shape} {array.dtype}"
            )
        return np.array(array, self._dtype)

    def add(self, value: np.ndarray) -> None:
        """Add the value of the next step."""
        self._waiting.append(value)
        if len(self._waiting) >= self._most:
            self.close()

    def close(self) -> None:
        """Write the buffered values."""
        if self._waiting:
            start = self._dataset.shape[0]
            self._dataset.resize(start + len(self._waiting), axis=0)
            self._dataset[start:] = np.stack(self._waiting)
            self._waiting = []


class JsonTextList(str):
    """A list of strings, stored as JSON."""

    __slots__ = ()


class ConstantColumn:
    """Numbers or text that usually stay constant: stored once, or per step if they change.

    Args:
        file: an open HDF5 file.
        path: path of the dataset.
        always: store per step in any case.
    """

    def __init__(self, file: HDF5Group, path: DatasetPath, *, always: bool = False) -> None:
        self._file, self._path, self._always = file, path, always
        self._first: Any = None
        self._count = 0
        self._series: list[Any] | None = None

    def convert(self, value: Any) -> Any:
        """Return a string, or a copy of an array.

        Raises:
            TrajectoryError: its type or shape differs from the first one's.
        """
        converted = value if isinstance(value, str) else np.array(numbers(value, "/".join(self._path)))
        if not self._count:
            return converted
        if isinstance(converted, str) != isinstance(self._first, str) or np.shape(converted) != np.shape(self._first):
            raise TrajectoryError(
                f"{'/'.join(self._path)}, step {self._count}: expected {_describe(self._first)}, as in the first step, "
                f"got {_describe(converted)}"
            )
        return converted

    def add(self, value: Any) -> None:
        """Add the value of the next step."""
        if not self._count:
            self._first = value
        if self._series is None and (self._always or not np.array_equal(value, self._first)):
            self._series = [self._first] * self._count
        if self._series is not None:
            self._series.append(value)
        self._count += 1

    def close(self) -> None:
        """Write the dataset."""
        name = "/".join(self._path)
        value = self._first if self._series is None else self._series
        if isinstance(self._first, str):
            made = self._file.create_dataset(name, data=value, dtype=hdf5().string_dtype())
        else:
            made = self._file.create_dataset(name, data=value if self._series is None else np.stack(value))
        if self._series is not None or np.ndim(self._first):  # its length may equal the number of steps
            made.attrs[PER_STEP] = self._series is not None
        if isinstance(self._first, JsonTextList):
            made.attrs[LIST] = True


def numbers(value: object, name: str) -> np.ndarray:
    """Return an array of numbers or booleans.

    Raises:
        TrajectoryError: it is something else.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise TrajectoryError(f"{name}: expected numbers, got lists of unequal lengths") from None
    if array.dtype.kind not in "biuf":
        raise TrajectoryError(f"{name}: expected numbers, got {type(value).__name__} of {array.dtype}")
    return array


def _describe(value: Any) -> str:
    return "text" if isinstance(value, str) else f"{np.shape(value)} {value.dtype}"
