"""HDF5 files, opened with care: what a file says of itself is believed only within limits.

A file may come from anywhere. It is read as numbers and text: no link out of the file is followed, and nothing is read
whose size its header puts beyond what an episode has.
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

    from xpl.trajectory.names import Place
    from xpl.trajectory.nodes import Dataset, File, Group

MOST_DATASETS = 4096
MOST_ENTRIES = 1 << 16
"""Names that are gone through, of groups too: links lead to one group from many."""
DEEPEST = 8
MOST_STEPS = 1 << 24
"""A week at 25 Hz."""
MOST_BYTES = 1 << 28
"""Of one row of a dataset, and of one of its chunks."""
MOST_READ = 1 << 28
"""Bytes that are read at once; a small file can claim any."""
MOST_FACT = 1 << 20
"""Numbers or texts of what is told of a whole episode."""
MOST_TEXT = 1 << 24
"""Characters of one text."""
_FEW_BYTES = 1 << 25
_EXPANSION = 64
"""Bytes that are read of one series for each byte of its file, at most, beyond those few: rows may be one another."""

PER_STEP = "per_step"
"""Attribute of a dataset with one row for each step, where neither its name nor its form tells."""
LIST = "list"
"""Attribute of a JSON text that stands for a list of texts, where its name does not tell."""


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


def opened(path: str) -> File:
    """Return an HDF5 file, open for reading.

    Raises:
        TrajectoryError: there is no file, or it is none of HDF5.
        ImportError: h5py is not installed.
    """
    library = hdf5()
    try:
        if not Path(path).is_file():  # whoever opens a pipe waits for its other end
            raise TrajectoryError(f"{path} is no file, or is not there")
        found: File = library.File(path, "r", locking=False)  # who writes puts whole files in place
    except OSError as error:
        raise TrajectoryError(f"{path} cannot be read as HDF5: {error.strerror or error}") from None
    return found


def group(root: Group, path: str) -> Group:
    """Return a group of a file, or below another one, by its path.

    Raises:
        TrajectoryError: there is none, or a link leads to it.
    """
    found = root
    for name in path.split("/"):
        inner = _entry(found, name) if name in found else None
        if not isinstance(inner, hdf5().Group):
            raise TrajectoryError(f"{where(root)} has no group {path}")
        found = inner
    return found


def most_read(size: int) -> int:
    """Return how many bytes of numbers, or of encoded images of one camera, files of a size hold at most."""
    return _FEW_BYTES + _EXPANSION * size


def datasets(root: Group) -> dict[Place, Dataset]:
    """Return every dataset of a file, or below a group of it, by its path from there.

    Raises:
        TrajectoryError: there are too many, too deep, or one lies in another file.
    """
    found: dict[Place, Dataset] = {}
    for path, dataset in _below(root, (), itertools.count(1)):
        found[path] = dataset
        if len(found) > MOST_DATASETS:
            raise TrajectoryError(f"{where(root)} has more than {MOST_DATASETS} datasets, no episode has that many")
    return found


def _below(node: Group, path: Place, visits: Iterator[int]) -> Iterator[tuple[Place, Dataset]]:
    library = hdf5()
    if len(path) > DEEPEST:
        raise TrajectoryError(f"{where(node)} lies deeper than {DEEPEST} groups")
    for name in node:
        if next(visits) > MOST_ENTRIES:
            raise TrajectoryError(
                f"{node.file.filename} has more than {MOST_ENTRIES} entries, no episode has that many"
            )
        place = (*path, str(name))
        entry = _entry(node, name)
        if isinstance(entry, library.Group):
            yield from _below(entry, place, visits)
        elif isinstance(entry, library.Dataset) and entry.shape is not None:  # else it has not even room for values
            _check(entry)
            yield place, entry


def _entry(node: Group, name: str) -> Any:
    """Return what a group has under a name; links are not followed."""
    if not isinstance(node.get(name, getlink=True), hdf5().HardLink):
        place = f"{where(node)}/{name}" if node.name != "/" else f"{node.file.filename}: {name}"
        raise TrajectoryError(f"{place} is a link; links are not followed, an episode is one file by itself")
    return node[name]


def address(node: Group) -> int:
    """Return where in its file a group lies, by which one that has several names is known."""
    return int(hdf5().h5o.get_info(node.id).addr)


def where(node: Group | Dataset) -> str:
    """Return how errors name what lies in a file."""
    return f"{node.file.filename}: {node.name.lstrip('/')}" if node.name != "/" else str(node.file.filename)


def _check(dataset: Dataset) -> None:
    if dataset.external or dataset.is_virtual:
        raise TrajectoryError(f"{where(dataset)} has its data in other files; an episode is one file by itself")
    shape = dataset.shape
    sizes = [math.prod(shape[1:]), math.prod(dataset.chunks or ())]
    if max(sizes) * dataset.dtype.itemsize > MOST_BYTES:
        raise TrajectoryError(f"{where(dataset)} has rows of shape {shape[1:]}, more than {MOST_BYTES} bytes each")


def is_text(dataset: Dataset) -> bool:
    """Tell whether a dataset holds text of variable length."""
    return hdf5().check_string_dtype(dataset.dtype) is not None and dataset.dtype.kind == "O"


def is_encoded(dataset: Dataset) -> bool:
    """Tell whether the rows of a dataset are encoded images: padded, of fixed length, or of variable length."""
    if dataset.dtype.kind in "SO":
        return bool(dataset.ndim == 1)
    return bool(dataset.dtype == np.uint8) and dataset.ndim == 2


def size_of(dataset: Dataset, index: object) -> int:
    """Return how many bytes a read takes: of a row, of a slice of them, or of all."""
    row = int(math.prod(dataset.shape[1:])) * int(dataset.dtype.itemsize)
    if isinstance(index, slice):
        return row * len(range(*index.indices(dataset.shape[0])))
    return row * (dataset.shape[0] if index == () and dataset.ndim else 1)


def rows(dataset: Dataset, index: object = ()) -> np.ndarray:
    """Return rows of a dataset of numbers, as it is stored.

    Raises:
        TrajectoryError: it holds none, claims more than is read at once, or cannot be read.
    """
    if dataset.dtype.kind not in "biuf":
        raise TrajectoryError(f"{where(dataset)}: expected numbers, got {dataset.shape} {dataset.dtype}")
    if size_of(dataset, index) > MOST_READ:
        raise TrajectoryError(f"{where(dataset)} claims more than {MOST_READ} bytes: read it in parts")
    try:
        return np.asarray(dataset[index])
    except (OSError, RuntimeError, ValueError) as error:
        step = f", step {index}" if isinstance(index, int) else ""
        raise TrajectoryError(f"{where(dataset)}{step} cannot be read: {error}") from None


def text(dataset: Dataset, index: object = ()) -> str | list[str]:
    """Return a text, or a list of them.

    Raises:
        TrajectoryError: it is no text, or too long.
    """
    if hdf5().check_string_dtype(dataset.dtype) is None:
        raise TrajectoryError(f"{where(dataset)}: expected text, got {dataset.shape} {dataset.dtype}")
    if size_of(dataset, index) > MOST_TEXT:  # of fixed width; what has none is counted when it is there
        raise TrajectoryError(f"{where(dataset)} claims more than {MOST_TEXT} characters of text")
    value = dataset[index]
    values = [value] if isinstance(value, (bytes, str)) else list(np.ravel(value))
    texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in values]
    if sum(map(len, texts)) > MOST_TEXT:
        raise TrajectoryError(f"{where(dataset)} has more than {MOST_TEXT} characters of text")
    return texts[0] if isinstance(value, (bytes, str)) else texts


def document(dataset: Dataset) -> Any:
    """Return what a dataset of JSON text holds; a list of texts that are none as it is.

    Raises:
        TrajectoryError: it is neither.
    """
    told = text(dataset)
    if isinstance(told, list):
        return told
    try:
        return json_text.parse(told)
    except json_text.JsonError:
        raise TrajectoryError(f"{where(dataset)}: expected a JSON text, got {told[:60]!r}") from None


def wordings(dataset: Dataset) -> list[str]:
    """Return the texts in a list of them, JSON or none, or the one text that is no list.

    Raises:
        TrajectoryError: it holds anything else.
    """
    told = text(dataset)
    found = document(dataset) if isinstance(told, str) and told.startswith("[") else told
    listed = [found] if isinstance(found, str) else found
    if not all(isinstance(one, str) for one in listed):
        raise TrajectoryError(f"{where(dataset)}: expected a list of texts")
    return list(listed)


def plain(value: Any) -> Any:
    """Return a value as JSON has it: arrays as lists, numpy's numbers as Python's, bytes as text."""
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
    return None if getattr(value, "shape", ()) is None else value  # the former is HDF5's value of nothing
