"""Safe reading of untrusted HDF5 files, within limits.

Only numbers and text are read; no link is followed, and nothing is read whose declared size exceeds the limits of an
episode.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import json_text
from xpl.trajectory.errors import TrajectoryError

if TYPE_CHECKING:
    from types import ModuleType

    from xpl.trajectory.hdf5_types import HDF5Dataset, HDF5File, HDF5Group
    from xpl.trajectory.names import DatasetPath

MOST_DATASETS = 4096
MOST_ENTRIES = 1 << 16
"""Most entries that are visited, including groups."""
DEEPEST = 8
MOST_STEPS = 1 << 24
"""A week at 25 Hz."""
MOST_BYTES = 1 << 28
"""Most bytes of one row of a dataset, and of one chunk."""
MOST_READ = 1 << 28
"""Most bytes of one read; a small file can declare any size."""
MOST_FACT = 1 << 20
"""Most values of a constant of an episode."""
MOST_TEXT = 1 << 24
"""Most characters of one text."""
_FEW_BYTES = 1 << 25
_EXPANSION = 64
"""Most bytes that are read of one series per byte of the file, beyond `_FEW_BYTES`: rows may share data."""

PER_STEP = "per_step"
"""Attribute of a dataset with one row per step, if neither name nor shape implies it."""
LIST = "list"
"""Attribute of a JSON text that is a list of strings, if its name does not imply it."""


def hdf5() -> ModuleType:
    """Return h5py.

    Raises:
        ImportError: it is not installed.
    """
    try:
        import h5py
    except ImportError:
        raise ImportError(
            f"trajectories are HDF5 files, and {sys.executable} has no h5py to read and write them: `pip install h5py`"
        ) from None
    library: ModuleType = h5py
    return library


def open_file(path: str) -> HDF5File:
    """Return an HDF5 file, open for reading.

    Raises:
        TrajectoryError: there is no file, or it is no HDF5 file.
        ImportError: h5py is not installed.
    """
    library = hdf5()
    try:
        if not Path(path).is_file():  # opening a pipe would block
            raise TrajectoryError(f"{path} is no file, or is not there")
        file: HDF5File = library.File(path, "r", locking=False)  # files are written elsewhere and renamed
    except OSError as error:
        raise TrajectoryError(f"{path} cannot be read as HDF5: {error.strerror or error}") from None
    return file


def group(root: HDF5Group, path: str) -> HDF5Group:
    """Return a group of a file, or below another one, by its path.

    Raises:
        TrajectoryError: there is none, or it is a link.
    """
    node = root
    for name in path.split("/"):
        inner = _entry(node, name) if name in node else None
        if not isinstance(inner, hdf5().Group):
            raise TrajectoryError(f"{describe(root)} has no group {path}")
        node = inner
    return node


def most_read(size: int) -> int:
    """Return the most bytes of numbers, or of encoded images of one camera, that are read of files of a size."""
    return _FEW_BYTES + _EXPANSION * size


def datasets(root: HDF5Group) -> dict[DatasetPath, HDF5Dataset]:
    """Return all datasets below a group, by path relative to it.

    Raises:
        TrajectoryError: there are too many or too deep, or one is in another file.
    """
    datasets: dict[DatasetPath, HDF5Dataset] = {}
    for path, dataset in _walk(root, (), itertools.count(1)):
        datasets[path] = dataset
        if len(datasets) > MOST_DATASETS:
            raise TrajectoryError(f"{describe(root)} has more than {MOST_DATASETS} datasets, no episode has that many")
    return datasets


def _walk(node: HDF5Group, path: DatasetPath, visits: Iterator[int]) -> Iterator[tuple[DatasetPath, HDF5Dataset]]:
    library = hdf5()
    if len(path) > DEEPEST:
        raise TrajectoryError(f"{describe(node)} lies deeper than {DEEPEST} groups")
    for name in node:
        if next(visits) > MOST_ENTRIES:
            raise TrajectoryError(
                f"{node.file.filename} has more than {MOST_ENTRIES} entries, no episode has that many"
            )
        entry_path = (*path, str(name))
        entry = _entry(node, name)
        if isinstance(entry, library.Group):
            yield from _walk(entry, entry_path, visits)
        elif isinstance(entry, library.Dataset) and entry.shape is not None:  # None: a dataset without values
            _check(entry)
            yield entry_path, entry


def _entry(node: HDF5Group, name: str) -> Any:
    """Return an entry of a group; links are not followed."""
    if not isinstance(node.get(name, getlink=True), hdf5().HardLink):
        location = f"{describe(node)}/{name}" if node.name != "/" else f"{node.file.filename}: {name}"
        raise TrajectoryError(f"{location} is a link; links are not followed, an episode is one file by itself")
    return node[name]


def address(node: HDF5Group) -> int:
    """Return the address of a group in its file, which identifies it under any name."""
    return int(hdf5().h5o.get_info(node.id).addr)


def describe(node: HDF5Group | HDF5Dataset) -> str:
    """Return the name of a group or dataset in errors."""
    return f"{node.file.filename}: {node.name.lstrip('/')}" if node.name != "/" else str(node.file.filename)


def _check(dataset: HDF5Dataset) -> None:
    if dataset.external or dataset.is_virtual:
        raise TrajectoryError(f"{describe(dataset)} has its data in other files; an episode is one file by itself")
    shape = dataset.shape
    sizes = [math.prod(shape[1:]), math.prod(dataset.chunks or ())]
    if max(sizes) * dataset.dtype.itemsize > MOST_BYTES:
        raise TrajectoryError(f"{describe(dataset)} has rows of shape {shape[1:]}, more than {MOST_BYTES} bytes each")


def is_text(dataset: HDF5Dataset) -> bool:
    """Return whether a dataset holds text of variable length."""
    return hdf5().check_string_dtype(dataset.dtype) is not None and dataset.dtype.kind == "O"


def is_encoded(dataset: HDF5Dataset) -> bool:
    """Return whether the rows of a dataset may be encoded images: padded, of fixed or of variable length."""
    if dataset.dtype.kind in "SO":
        return bool(dataset.ndim == 1)
    return bool(dataset.dtype == np.uint8) and dataset.ndim == 2


def size_of(dataset: HDF5Dataset, index: object) -> int:
    """Return the bytes of a read of one row, a slice or all rows."""
    row = int(math.prod(dataset.shape[1:])) * int(dataset.dtype.itemsize)
    if isinstance(index, slice):
        return row * len(range(*index.indices(dataset.shape[0])))
    return row * (dataset.shape[0] if index == () and dataset.ndim else 1)


def rows(dataset: HDF5Dataset, index: object = ()) -> np.ndarray:
    """Return stored rows of a dataset of numbers.

    Raises:
        TrajectoryError: it has no numbers, declares too many bytes, or cannot be read.
    """
    if dataset.dtype.kind not in "biuf":
        raise TrajectoryError(f"{describe(dataset)}: expected numbers, got {dataset.shape} {dataset.dtype}")
    if size_of(dataset, index) > MOST_READ:
        raise TrajectoryError(f"{describe(dataset)} claims more than {MOST_READ} bytes: read it in parts")
    try:
        return np.asarray(dataset[index])
    except (OSError, RuntimeError, ValueError) as error:
        step = f", step {index}" if isinstance(index, int) else ""
        raise TrajectoryError(f"{describe(dataset)}{step} cannot be read: {error}") from None


def text(dataset: HDF5Dataset, index: object = ()) -> str | list[str]:
    """Return a text, or a list of them.

    Raises:
        TrajectoryError: it is no text, or too long.
    """
    if hdf5().check_string_dtype(dataset.dtype) is None:
        raise TrajectoryError(f"{describe(dataset)}: expected text, got {dataset.shape} {dataset.dtype}")
    if size_of(dataset, index) > MOST_TEXT:  # of fixed width; what has none is counted when it is there
        raise TrajectoryError(f"{describe(dataset)} claims more than {MOST_TEXT} characters of text")
    value = dataset[index]
    values = [value] if isinstance(value, (bytes, str)) else list(np.ravel(value))
    texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in values]
    if sum(map(len, texts)) > MOST_TEXT:
        raise TrajectoryError(f"{describe(dataset)} has more than {MOST_TEXT} characters of text")
    return texts[0] if isinstance(value, (bytes, str)) else texts


def document(dataset: HDF5Dataset) -> Any:
    """Return the value of a dataset of JSON text; a list of strings is returned unchanged.

    Raises:
        TrajectoryError: it is neither.
    """
    content = text(dataset)
    if isinstance(content, list):
        return content
    try:
        return json_text.parse(content)
    except json_text.JsonError:
        raise TrajectoryError(f"{describe(dataset)}: expected a JSON text, got {content[:60]!r}") from None


def instructions(dataset: HDF5Dataset) -> list[str]:
    """Return the instructions in a list, a JSON list, or a single text.

    Raises:
        TrajectoryError: it is something else.
    """
    content = text(dataset)
    parsed = document(dataset) if isinstance(content, str) and content.startswith("[") else content
    listed = [parsed] if isinstance(parsed, str) else parsed
    if not all(isinstance(one, str) for one in listed):
        raise TrajectoryError(f"{describe(dataset)}: expected a list of texts")
    return list(listed)


def plain(value: Any) -> Any:
    """Return a value as plain data: arrays as lists, numpy numbers as Python numbers, bytes as text."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return value.tolist()
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(entry) for entry in value]
    return _scalar(value)


def _scalar(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, str):  # h5py gives bytes that are no UTF-8 as surrogates
        return value if value.isascii() else value.encode("utf-8", "surrogatepass").decode("utf-8", "replace")
    if isinstance(value, (complex, np.generic)):
        return str(value)
    return None if getattr(value, "shape", ()) is None else value  # h5py.Empty has shape None
