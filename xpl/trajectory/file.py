"""File of an episode: opened on first access, datasets read row by row."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from xpl import _spec as spec
from xpl.trajectory import image_datasets, names, storage
from xpl.trajectory.errors import TrajectoryError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import TracebackType

    from xpl.trajectory.hdf5_types import HDF5Dataset, HDF5File
    from xpl.trajectory.image_datasets import ImageSeries

INFO = spec.Trajectory.ADDITIONAL_INFO
NO_VALUE = object()
"""Value of a dataset that is neither numbers nor text."""
_READS: dict[names.DatasetPath, Callable[[HDF5Dataset], object]] = {
    (spec.Trajectory.INSTRUCTIONS,): storage.instructions,
    (spec.Trajectory.SUBTASKS,): storage.document,
}
_FRAMES = (spec.Camera.COLOR, spec.Camera.DEPTH)
_BLOCK_BYTES = 1 << 22
_Own = TypeVar("_Own", bound="EpisodeFile")


class EpisodeFile:
    """Datasets of one recorded episode; see `Trajectory`.

    Args:
        path: the file.
        key: its name in a data set; by default the file name without suffix.
        steps: number of steps, if known.
    """

    def __init__(self, path: str, *, key: str | None = None, steps: int | None = None) -> None:
        self.path = path
        self.key = key or Path(path).stem
        self._steps = steps
        self._file: HDF5File | None = None
        self._datasets: dict[names.DatasetPath, HDF5Dataset] | None = None
        self._pictures: dict[str, ImageSeries] | None = None
        self._blocks: dict[names.DatasetPath, tuple[int, np.ndarray]] = {}
        self._kinds: dict[names.DatasetPath, tuple[str, Any]] = {}

    def __len__(self) -> int:
        """Return the number of control steps.

        Raises:
            TrajectoryError: it has neither state nor action, or series of unequal lengths.
        """
        if self._steps is None:
            self._steps = self._count_steps()
        return self._steps

    def __enter__(self: _Own) -> _Own:  # noqa: PYI019 - Python 3.9 has no Self
        """Return the trajectory itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        """Drop the open file: after unpickling, for example in another process, it is opened again."""
        return {**self.__dict__, "_file": None, "_datasets": None, "_pictures": None, "_blocks": {}, "_kinds": {}}

    def close(self) -> None:
        """Close the file; the next access opens it again."""
        file, self._file, self._datasets, self._pictures, self._blocks, self._kinds = (
            self._file,
            None,
            None,
            None,
            {},
            {},
        )
        if file is not None:
            file.close()

    @property
    def file(self) -> HDF5File:
        """The file, open for reading.

        Raises:
            TrajectoryError: it cannot be read.
        """
        if self._file is None:
            self._file = storage.open_file(self.path)
        return self._file

    @property
    def datasets(self) -> Mapping[names.DatasetPath, HDF5Dataset]:
        """All h5py datasets of the file, by path.

        Raises:
            TrajectoryError: the file cannot be read.
        """
        if self._datasets is None:
            self._datasets = storage.datasets(self.file)
            expected = self._steps
            if expected is not None and expected not in self._lengths().values():
                self.close()
                raise TrajectoryError(f"{self.path} has another number of steps than {expected}, which its index says")
        return self._datasets

    def rows(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return stored rows of a dataset of numbers, or of a column of text.

        Args:
            name: path in the file, `state/arm_joint_states`.
            start: first row, from 0.
            stop: row after the last one; None for all.

        Returns:
            (rows, ...) in the stored dtype; str for text.

        Raises:
            KeyError: there is no such dataset.
            TrajectoryError: it is neither, or cannot be read.
        """
        path = tuple(name.split("/"))
        if path not in self.datasets:
            raise KeyError(f"{self.path} has no {name}; it has {', '.join(map('/'.join, self.datasets))}")
        dataset = self.datasets[path]
        index = slice(start, stop) if dataset.ndim else ()
        if dataset.ndim == 1 and self._read_as(path, dataset)[0] == "text":
            return np.array(storage.text(dataset, index), dtype=str)
        return storage.rows(dataset, index)

    def _lengths(self) -> dict[names.DatasetPath, int]:
        return {path: dataset.shape[0] for path, dataset in self.datasets.items() if self._has_rows(path, dataset)}

    def _count_steps(self) -> int:
        lengths = self._lengths()
        if not lengths:
            raise TrajectoryError(f"{self.path} has neither `state` nor `action`: a trajectory has both, step by step")
        first = next(iter(lengths))
        for path, length in lengths.items():
            if length != lengths[first]:
                raise TrajectoryError(
                    f"{self.path}: {'/'.join(path)} has {length} steps and {'/'.join(first)} {lengths[first]}"
                )
        if lengths[first] > storage.MOST_STEPS:
            raise TrajectoryError(f"{self.path} has {lengths[first]} steps, more than {storage.MOST_STEPS}")
        return int(lengths[first])

    @staticmethod
    def _has_rows(path: names.DatasetPath, dataset: HDF5Dataset) -> bool:
        return dataset.ndim > 0 and (names.is_series(path) or names.is_image(path, *_FRAMES))

    def _check_step(self, step: int) -> int:
        count = len(self)
        if not -count <= step < count:
            raise IndexError(f"{self.path} has {count} steps, there is no step {step}")
        return step % count

    def _value(self, path: names.DatasetPath, dataset: HDF5Dataset, step: int) -> Any:
        """Return the value of a dataset at a step."""
        kind, constant = self._read_as(path, dataset)
        if kind == "constant":
            return np.array(constant) if isinstance(constant, np.ndarray) else constant
        if kind == "image":
            return image_datasets.read_decoded(dataset, step)
        if kind == "text":
            return storage.text(dataset, (step,))
        row = self._row(path, dataset, step)
        if names.is_series(path) and row.ndim == 0:
            return row[None]  # (T,) instead of (T, 1), as some files store one gripper
        return row if row.ndim else row.item()

    def _read_as(self, path: names.DatasetPath, dataset: HDF5Dataset) -> tuple[str, Any]:
        """Return how a dataset is read, and its value if it is constant."""
        if path not in self._kinds:
            self._kinds[path] = self._kind(path, dataset)
        return self._kinds[path]

    def _kind(self, path: names.DatasetPath, dataset: HDF5Dataset) -> tuple[str, Any]:
        if names.is_image(path, spec.Camera.COLOR) and storage.is_encoded(dataset):
            return "image", None
        if storage.hdf5().check_string_dtype(dataset.dtype) is not None:
            is_list = dataset.attrs.get(storage.LIST, False)
            reads: Callable[[HDF5Dataset], object] = storage.document if is_list else storage.text
            reads = _READS.get(path, reads)
            is_column = path not in _READS and dataset.ndim == 1 and self._is_per_step(path, dataset)
            return ("text", None) if is_column else ("constant", reads(dataset))
        if dataset.dtype.kind not in "biuf":
            if names.is_series(path):
                raise TrajectoryError(
                    f"{storage.describe(dataset)}: expected numbers for each step, got {dataset.dtype}"
                )
            return "constant", NO_VALUE  # of another program
        if self._is_per_step(path, dataset):
            return "row", None
        value = storage.rows(dataset)
        return "constant", value.item() if value.ndim == 0 else value

    def _is_per_step(self, path: names.DatasetPath, dataset: HDF5Dataset) -> bool:
        if storage.PER_STEP in dataset.attrs:
            return bool(dataset.attrs[storage.PER_STEP])
        if path[:2] == (INFO, names.STEPS) or self._has_rows(path, dataset):
            return True
        if names.is_image(path, spec.Camera.INTRINSIC_MATRIX, spec.Camera.EXTRINSICS_MATRIX):
            return bool(dataset.ndim == 3)
        if path[0] == INFO or names.is_image(path, spec.Camera.SHAPE):
            return False
        return bool(dataset.shape[:1] == (len(self),))

    def _row(self, path: names.DatasetPath, dataset: HDF5Dataset, step: int) -> np.ndarray:
        """Return a row; small rows are read in blocks."""
        size = dataset.dtype.itemsize * int(np.prod(dataset.shape[1:]))
        count = min(256, _BLOCK_BYTES // max(1, size))
        if count < 2 or size > 4096:
            return storage.rows(dataset, step)
        start, block = self._blocks.get(path, (0, None))
        if block is None or not start <= step < start + len(block):
            start = step - step % count
            block = storage.rows(dataset, slice(start, start + count))
            self._blocks[path] = start, block
        return np.array(block[step - start])
