"""HDF5 files whose datasets have one row per step, as those of robomimic, ACT and RoboTwin.

`xpl.trajectory.storage` opens and reads the files; it follows no link and checks every size.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, Protocol, TypeVar

import numpy as np

from xpl.trajectory import TrajectoryError, storage
from xpl.trajectory import image_datasets as stored
from xpl_cli.data.formats import image_files, libraries
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Extras
from xpl_cli.data.sets.outlined import Outline, OutlinedEpisode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.trajectory.hdf5_types import HDF5Dataset, HDF5File, HDF5Group
    from xpl.trajectory.names import DatasetPath

_SUFFIXES: Final = (".hdf5", ".h5")
_DEPTHS: Final = ("*", "*/*", "*/*/*")
_MOST_FILES: Final = 1_000_000


def files(path: Path) -> list[Path]:
    """Return the HDF5 files of a dataset in natural order: the file itself, or those nearest below a folder.

    Raises:
        DataError: there are more than a million files.
    """
    paths = list(itertools.islice(_files(path), _MOST_FILES + 1))
    if len(paths) > _MOST_FILES:
        raise DataError(f"{path} has more than {_MOST_FILES} files")
    return paths if path.is_file() else sorted(paths, key=lambda one: natural(one.relative_to(path).as_posix()))


def first(path: Path) -> Path | None:
    """Return one of the HDF5 files of a dataset; None if it has none."""
    return next(_files(path), None)


def is_hdf5_set(path: Path, recognises: Callable[[HDF5File], bool]) -> bool:
    """Tell whether a dataset consists of HDF5 files of a format, by one of them.

    Args:
        path: of the dataset.
        recognises: tells whether an open file is of the format.

    Raises:
        DataError: that file is damaged.
    """
    file = first(path)
    if file is None:
        return False
    with opened(file) as handle:
        return recognises(handle)


def _files(path: Path) -> Iterator[Path]:
    """Yield the files of a dataset in directory order; a file given by its path may have any suffix but .zip."""
    if path.is_file() and path.suffix != ".zip":
        yield path
    for depth in _DEPTHS if path.is_dir() else ():
        is_found = False
        for one in path.glob(depth):
            if one.suffix in _SUFFIXES and not one.name.startswith(".") and one.is_file():
                is_found = True
                yield one
        if is_found:
            return


@contextmanager
def opened(path: Path) -> Iterator[HDF5File]:
    """Open a file for reading.

    Raises:
        DataError: the file does not exist, is no HDF5 file, or is damaged.
    """
    libraries.h5py()
    with data_errors(path), storage.open_file(str(path)) as file:
        yield file


class _Closable(Protocol):
    def close(self) -> None: ...


_Opened = TypeVar("_Opened", bound=_Closable)


class OpenFileCache(Generic[_Opened]):
    """Keeps the last file open until another one is read: opening takes longer than reading a column.

    Args:
        opens: opens a file by its path.
    """

    def __init__(self, opens: Callable[[str], _Opened]) -> None:
        self._opens = opens
        self._path: Path | None = None
        self._file: _Opened | None = None

    @contextmanager
    def opened(self, path: Path) -> Iterator[_Opened]:
        """Yield a file, opened if it is not open yet; raises as `opened`."""
        libraries.h5py()
        try:
            with data_errors(path):
                if self._file is None or self._path != path:
                    self._close()
                    self._path, self._file = path, self._opens(str(path))
                yield self._file
        except DataError:
            self._close()
            raise

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = None


@contextmanager
def data_errors(path: str | Path) -> Iterator[None]:
    """Turn errors of h5py into `DataError`.

    Raises:
        DataError: the file cannot be read.
    """
    try:
        yield
    except TrajectoryError as error:
        raise DataError(str(error)) from None
    except (OSError, RuntimeError, KeyError) as error:
        raise DataError(f"{path} is damaged: {str(error)[:200]}") from None


def attributes(node: HDF5Group | HDF5Dataset) -> dict[str, Any]:
    """Return the attributes of a group or file as JSON values."""
    return {name: storage.plain(value) for name, value in node.attrs.items()}


class Hdf5Episode(OutlinedEpisode):
    """An episode that is a group of an HDF5 file.

    Args:
        file: its path, and the cache that keeps one of the dataset's files open.
        group: the group in it; "" for the whole file.
        key: its name in the dataset.
        steps: HDF5 datasets; the first that exists gives the number of steps.
        instructions: the language instructions.
    """

    def __init__(
        self,
        file: tuple[Path, OpenFileCache[HDF5File]],
        group: str,
        key: str,
        steps: tuple[str, ...],
        instructions: tuple[str, ...] = (),
    ) -> None:
        super().__init__(key)
        self._path, self._files = file
        self._group, self._steps, self._instructions = group, steps, instructions

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        column_info = self.columns[column]
        with self._files.opened(self._path) as file:
            dataset = self._root(file)[column]
            if column_info.dtype == "str":
                return np.array(storage.text(dataset, slice(start, stop)), dtype=str)
            return storage.rows(dataset, slice(start, stop))

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera; the file is opened separately while they are read."""
        camera_info = self.cameras[camera]
        with opened(self._path) as file:
            dataset = self._root(file)[camera]
            steps = range(*slice(start, stop).indices(self.length))
            if camera_info.encoding == "raw":
                for index in steps:
                    image = storage.rows(dataset, index)
                    yield image[..., 0] if camera_info.kind == "depth" and image.ndim == 3 else image
                return
            for index, data in stored.read_encoded(dataset, steps):
                yield image_files.decode_image(
                    data.rstrip(b"\0"), f"{self._path}, {self._key}, {camera}, image {index}"
                )

    def _root(self, file: HDF5File) -> HDF5Group:
        return storage.group(file, self._group) if self._group else file

    def outline(self) -> Outline:
        """Read everything but rows and images."""
        where = f"{self._path}, {self._key}"
        with self._files.opened(self._path) as file:
            root = self._root(file)
            datasets = storage.datasets(root)
            length = self._count_steps(datasets, where)
            columns: dict[str, ColumnInfo] = {}
            cameras: dict[str, CameraInfo] = {}
            extras = attributes(root)
            for path, dataset in datasets.items():
                name = "/".join(path)
                is_steps = bool(dataset.shape) and dataset.shape[0] == length
                picture = stored.image_series(path, dataset) if is_steps and length else None
                if picture is not None:
                    beside = _matrices(path, datasets)
                    cameras[name] = CameraInfo(picture.height, picture.width, picture.kind, picture.encoding, **beside)
                elif is_steps and (column := _column(dataset)) is not None:
                    columns[name] = column
                elif dataset.size <= storage.MOST_FACT and storage.size_of(dataset, ()) <= storage.MOST_TEXT:
                    extras[name] = storage.plain(dataset[()])
        return Outline(length, self._sentences(extras), columns, cameras, extras)

    def _sentences(self, extras: Extras) -> tuple[str, ...]:
        """Return the instructions; subclasses read them from the file's metadata."""
        del extras
        return self._instructions

    def _count_steps(self, datasets: Mapping[DatasetPath, HDF5Dataset], where: str) -> int:
        for name in self._steps:
            dataset = datasets.get(tuple(name.split("/")))
            if dataset is not None and dataset.shape:
                return int(dataset.shape[0])
        raise DataError(f"{where} has no {' or '.join(self._steps)}, one of which every episode of this format has")


def _column(dataset: HDF5Dataset) -> ColumnInfo | None:
    """Return the column of an HDF5 dataset; None if it holds neither numbers nor text."""
    if libraries.h5py().check_string_dtype(dataset.dtype) is not None and dataset.ndim == 1:
        return ColumnInfo((), "str")
    return ColumnInfo(tuple(dataset.shape[1:]), dataset.dtype.name) if dataset.dtype.kind in "biuf" else None


def _matrices(path: DatasetPath, datasets: Mapping[DatasetPath, HDF5Dataset]) -> dict[str, Any]:
    """Return the camera matrices stored beside a camera's images."""
    result = {}
    for field, names in (
        ("intrinsics", ("intrinsic_matrix", "intrinsic_cv")),
        ("extrinsics", ("extrinsic_matrix", "extrinsics_matrix", "extrinsic_cv")),
    ):
        for one in names if len(path) > 1 else ():
            dataset = datasets.get((*path[:-1], one))
            if dataset is not None and dataset.dtype.kind == "f" and dataset.size <= storage.MOST_FACT:
                result[field] = storage.rows(dataset)
    return result


def natural(name: str) -> tuple[tuple[int, str], ...]:
    """Return a sort key that orders `episode2` before `episode10`."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"([0-9]+)", name))
