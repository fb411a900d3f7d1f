"""What a file grows by: datasets that take one value for each step, in bounded memory however long an episode is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.storage import LIST, PER_STEP, hdf5

if TYPE_CHECKING:
    from xpl.trajectory.names import Place
    from xpl.trajectory.nodes import Group

ROWS = 64
"""Most values that wait in memory, and those of a chunk where they are small."""
WAITING_BYTES = 1 << 22


class Column(Protocol):
    """Takes a value for each step."""

    def fitting(self, value: Any) -> Any:
        """Return the value of the next step as `add` takes it.

        Raises:
            TrajectoryError: it does not go with those before it.
        """

    def add(self, value: Any) -> None:
        """Take what `fitting` made of the value of the next step."""

    def close(self) -> None:
        """Write what is still in memory."""


class Rows:
    """Numbers, of one shape and type: a dataset (T, *shape).

    Args:
        file: an open HDF5 file.
        path: where in it.
        first: the first value, which all others have to be like.
        chunk: rows of a chunk.
        marked: whether the file says that it has a row for each step, where its name does not.
        compression: options of h5py for the dataset.
    """

    def __init__(
        self,
        file: Group,
        path: Place,
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
        # HDF5 wants chunks of at least one value, and only what can grow may have larger ones than there are.
        sizes = {
            "shape": (0, *first.shape),
            "maxshape": (None, *(size or None for size in first.shape)),
            "chunks": (min(chunk, self._most), *(max(1, size) for size in first.shape)),
        }
        self._dataset = file.create_dataset(self._name, dtype=first.dtype, **sizes, **compression)
        if marked:
            self._dataset.attrs[PER_STEP] = True

    def fitting(self, value: Any) -> np.ndarray:
        """Return a copy: simulators use their arrays again.

        Raises:
            TrajectoryError: it has another shape or type than the first one.
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
        """Take the value of the next step."""
        self._waiting.append(value)
        if len(self._waiting) >= self._most:
            self.close()

    def close(self) -> None:
        """Write what is still in memory."""
        if self._waiting:
            start = self._dataset.shape[0]
            self._dataset.resize(start + len(self._waiting), axis=0)
            self._dataset[start:] = np.stack(self._waiting)
            self._waiting = []


class Listed(str):
    """A list of texts, written as JSON."""

    __slots__ = ()


class Steady:
    """What usually stays as it is, numbers or a text: stored once, and for each step from where it changes.

    Args:
        file: an open HDF5 file.
        path: where in it.
        always: stored for each step whether it changes or not.
    """

    def __init__(self, file: Group, path: Place, *, always: bool = False) -> None:
        self._file, self._path, self._always = file, path, always
        self._first: Any = None
        self._count = 0
        self._series: list[Any] | None = None

    def fitting(self, value: Any) -> Any:
        """Return a text, or a copy of numbers.

        Raises:
            TrajectoryError: it is of another kind or shape than the first one.
        """
        found = value if isinstance(value, str) else np.array(numbers(value, "/".join(self._path)))
        if not self._count:
            return found
        if isinstance(found, str) != isinstance(self._first, str) or np.shape(found) != np.shape(self._first):
            raise TrajectoryError(
                f"{'/'.join(self._path)}, step {self._count}: expected {_told(self._first)}, as the first step has, "
                f"got {_told(found)}"
            )
        return found

    def add(self, value: Any) -> None:
        """Take the value of the next step."""
        if not self._count:
            self._first = value
        if self._series is None and (self._always or not np.array_equal(value, self._first)):
            self._series = [self._first] * self._count
        if self._series is not None:
            self._series.append(value)
        self._count += 1

    def close(self) -> None:
        """Write it."""
        name = "/".join(self._path)
        value = self._first if self._series is None else self._series
        if isinstance(self._first, str):
            made = self._file.create_dataset(name, data=value, dtype=hdf5().string_dtype())
        else:
            made = self._file.create_dataset(name, data=value if self._series is None else np.stack(value))
        if self._series is not None or np.ndim(self._first):  # an array may have as many rows as there are steps
            made.attrs[PER_STEP] = self._series is not None
        if isinstance(self._first, Listed):
            made.attrs[LIST] = True


def numbers(value: object, name: str) -> np.ndarray:
    """Return an array of numbers or truth values.

    Raises:
        TrajectoryError: it is none.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise TrajectoryError(f"{name}: expected numbers, got lists of unequal lengths") from None
    if array.dtype.kind not in "biuf":
        raise TrajectoryError(f"{name}: expected numbers, got {type(value).__name__} of {array.dtype}")
    return array


def _told(value: Any) -> str:
    return "text" if isinstance(value, str) else f"{np.shape(value)} {value.dtype}"
