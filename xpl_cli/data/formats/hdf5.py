"""HDF5 files whose datasets have a row for each step: what robomimic, ACT and RoboTwin have in common.

Files are opened and read by `xpl.trajectory.storage`, which follows no link and believes no size.
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
from xpl.trajectory import pictures as stored
from xpl_cli.data.formats import image_codec, libraries
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Extras
from xpl_cli.data.sets.outlined import Outline, OutlinedEpisode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.trajectory.names import Place
    from xpl.trajectory.nodes import Dataset, File, Group

_SUFFIXES: Final = (".hdf5", ".h5")
_DEPTHS: Final = ("*", "*/*", "*/*/*")
_MOST_FILES: Final = 1_000_000


def files(path: Path) -> list[Path]:
    """Return the HDF5 files of a set, in the order in which people count: itself, or those nearest below a folder.

    Raises:
        DataError: they are too many.
    """
    found = list(itertools.islice(_files(path), _MOST_FILES + 1))
    if len(found) > _MOST_FILES:
        raise DataError(f"{path} has more than {_MOST_FILES} files")
    return found if path.is_file() else sorted(found, key=lambda one: natural(one.relative_to(path).as_posix()))


def first(path: Path) -> Path | None:
    """Return any of the HDF5 files of a set; None if it has none."""
    return next(_files(path), None)


def is_hdf5_set(path: Path, recognises: Callable[[File], bool]) -> bool:
    """Tell whether a set is of HDF5 files of a kind, by one of them.

    Args:
        path: of the set.
        recognises: tells it of an open file.

    Raises:
        DataError: that file is damaged.
    """
    file = first(path)
    if file is None:
        return False
    with opened(file) as found:
        return recognises(found)


def _files(path: Path) -> Iterator[Path]:
    """Yield the files of a set, as the system lists them; a file that is no ZIP is one, whatever it is called."""
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
def opened(path: Path) -> Iterator[File]:
    """Open a file for reading.

    Raises:
        DataError: it is not there, is no HDF5 file, or is damaged where it is read.
    """
    libraries.h5py()
    with data_errors(path), storage.opened(str(path)) as file:
        yield file


class _Closable(Protocol):
    def close(self) -> None: ...


_Opened = TypeVar("_Opened", bound=_Closable)


class OpenFileCache(Generic[_Opened]):
    """The file that was read last, open until another one is: opening it takes longer than reading a column.

    Args:
        opens: a file, by its path.
    """

    def __init__(self, opens: Callable[[str], _Opened]) -> None:
        self._opens = opens
        self._path: Path | None = None
        self._file: _Opened | None = None

    @contextmanager
    def opened(self, path: Path) -> Iterator[_Opened]:
        """Open a file for reading, where it is not open; raises as `opened`."""
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
    """Say in one sentence what is wrong with a file.

    Raises:
        DataError: it cannot be read.
    """
    try:
        yield
    except TrajectoryError as error:
        raise DataError(str(error)) from None
    except (OSError, RuntimeError, KeyError) as error:
        raise DataError(f"{path} is damaged: {str(error)[:200]}") from None


def attributes(node: Group | Dataset) -> dict[str, Any]:
    """Return the attributes of a group or file as plain data."""
    return {name: storage.plain(value) for name, value in node.attrs.items()}


class Hdf5Episode(OutlinedEpisode):
    """An episode that is a group of an HDF5 file.

    Args:
        file: which one it is, and what keeps one of the set's files open.
        group: the group in it; "" for the whole file.
        key: its name in the set.
        steps: the dataset, or datasets, the first of which that is there says how many steps there are.
        instructions: what the robot was told.
    """

    def __init__(
        self,
        file: tuple[Path, OpenFileCache[File]],
        group: str,
        key: str,
        steps: tuple[str, ...],
        instructions: tuple[str, ...] = (),
    ) -> None:
        super().__init__(key)
        self._path, self._files = file
        self._group, self._steps, self._told = group, steps, instructions

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        known = self.columns[column]
        with self._files.opened(self._path) as file:
            dataset = self._root(file)[column]
            if known.dtype == "str":
                return np.array(storage.text(dataset, slice(start, stop)), dtype=str)
            return storage.rows(dataset, slice(start, stop))

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera; their file is open of its own as long as they are read."""
        known = self.cameras[camera]
        with opened(self._path) as file:
            dataset = self._root(file)[camera]
            steps = range(*slice(start, stop).indices(self.length))
            if known.encoding == "raw":
                for index in steps:
                    image = storage.rows(dataset, index)
                    yield image[..., 0] if known.kind == "depth" and image.ndim == 3 else image
                return
            for index, data in stored.series(dataset, steps):
                yield image_codec.decode_image(
                    data.rstrip(b"\0"), f"{self._path}, {self._key}, {camera}, image {index}"
                )

    def _root(self, file: File) -> Group:
        return storage.group(file, self._group) if self._group else file

    def outline(self) -> Outline:
        """Return what the file says without rows and images."""
        where = f"{self._path}, {self._key}"
        with self._files.opened(self._path) as file:
            root = self._root(file)
            found = storage.datasets(root)
            length = self._count_steps(found, where)
            columns: dict[str, ColumnInfo] = {}
            cameras: dict[str, CameraInfo] = {}
            extras = attributes(root)
            for path, dataset in found.items():
                name = "/".join(path)
                is_steps = bool(dataset.shape) and dataset.shape[0] == length
                picture = stored.found(path, dataset) if is_steps and length else None
                if picture is not None:
                    beside = _matrices(path, found)
                    cameras[name] = CameraInfo(picture.height, picture.width, picture.kind, picture.encoding, **beside)
                elif is_steps and (column := _column(dataset)) is not None:
                    columns[name] = column
                elif dataset.size <= storage.MOST_FACT and storage.size_of(dataset, ()) <= storage.MOST_TEXT:
                    extras[name] = storage.plain(dataset[()])
        return Outline(length, self._sentences(extras), columns, cameras, extras)

    def _sentences(self, extras: Extras) -> tuple[str, ...]:
        """Return what the robot was told, by what else the file says."""
        del extras
        return self._told

    def _count_steps(self, found: Mapping[Place, Dataset], where: str) -> int:
        for name in self._steps:
            dataset = found.get(tuple(name.split("/")))
            if dataset is not None and dataset.shape:
                return int(dataset.shape[0])
        raise DataError(f"{where} has no {' or '.join(self._steps)}, one of which every episode of this format has")


def _column(dataset: Dataset) -> ColumnInfo | None:
    """Return what a dataset is as a column; None if it holds no numbers and no texts."""
    if libraries.h5py().check_string_dtype(dataset.dtype) is not None and dataset.ndim == 1:
        return ColumnInfo((), "str")
    return ColumnInfo(tuple(dataset.shape[1:]), dataset.dtype.name) if dataset.dtype.kind in "biuf" else None


def _matrices(path: Place, found: Mapping[Place, Dataset]) -> dict[str, Any]:
    """Return the matrices that lie beside a camera's images."""
    result = {}
    for field, names in (
        ("intrinsics", ("intrinsic_matrix", "intrinsic_cv")),
        ("extrinsics", ("extrinsic_matrix", "extrinsics_matrix", "extrinsic_cv")),
    ):
        for one in names if len(path) > 1 else ():
            dataset = found.get((*path[:-1], one))
            if dataset is not None and dataset.dtype.kind == "f" and dataset.size <= storage.MOST_FACT:
                result[field] = storage.rows(dataset)
    return result


def natural(name: str) -> tuple[tuple[int, str], ...]:
    """Return what sorts `episode2` before `episode10`."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"([0-9]+)", name))
