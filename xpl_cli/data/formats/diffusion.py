"""Diffusion Policy's zarr: arrays of all steps below `data/`, and where episodes end in `meta/episode_ends`.

Source: Diffusion Policy's common/replay_buffer.py; zarr's format 2. It holds no instructions, rate or robot.
"""

from __future__ import annotations

import math
import re
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl.image_codec import PIXELS
from xpl_cli.basics import files
from xpl_cli.data.formats import libraries
from xpl_cli.data.sets import documents
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Demonstrations, Extras
from xpl_cli.data.sets.outlined import Outline, OutlinedEpisode

if TYPE_CHECKING:
    from numpy.typing import NDArray

NAME: Final = "diffusion-policy"
ENDS: Final = "meta/episode_ends"
_SMALLEST = 8
_MOST_CHUNK: Final = 1 << 27
_MOST_EPISODES: Final = 1 << 22
_MOST_ARRAYS: Final = 1024
_MOST_DECLARED: Final = 1 << 20
_ARRAY: Final = ".zarray"
_READ: Final = re.compile(r"(?:.*/)?(?:meta/episode_ends|data/[^/]+)/\.zarray")
_SIZES: Final = {"type": "array", "minItems": 1, "maxItems": 8, "items": {"type": "integer", "minimum": 0}}
_CODEC: Final = {
    "type": ["object", "null"],
    "required": ["id"],
    "properties": {"id": {"enum": ["blosc", "bz2", "delta", "gzip", "lz4", "lzma", "shuffle", "zlib", "zstd"]}},
}
"""Codecs of numcodecs that only compress numbers; others may unpickle, or belong to another library."""
_ARRAY_SCHEMA: Final = documents.schema_text(
    {
        "type": "object",
        "required": ["zarr_format", "shape", "chunks", "dtype", "compressor", "filters"],
        "properties": {
            "zarr_format": {"const": 2},
            "shape": _SIZES,
            "chunks": _SIZES,
            "dtype": {"type": "string", "pattern": "^[<>|][biuf](1|2|4|8)$"},
            "compressor": _CODEC,
            "filters": {"type": ["array", "null"], "maxItems": 4, "items": _CODEC},
        },
    }
)


def recognises(path: Path) -> bool:
    """Tell whether a folder or ZIP file is a dataset of this format."""
    return (path / ENDS).is_dir() or (path.is_file() and path.suffix == ".zip")


def opened(path: Path) -> DiffusionSet:
    """Return the dataset."""
    return DiffusionSet(path)


class DiffusionSet(Demonstrations):
    """A zarr store."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, NAME)
        self._path = path
        self._store = _open_store(path)
        with _data_errors(path):
            store = self._store
            ends = store.get(ENDS)
            if ends is None or "data" not in store:
                raise DataError(f"{path} has no data and {ENDS}, which Diffusion Policy's stores have")
            self._ends: list[int] = np.asarray(ends[:], np.int64).tolist()
            self._extras: Extras = dict(store.attrs)
            self.contents = {name: _describe_array(name, array) for name, array in sorted(store["data"].arrays())}
        starts = [0, *self._ends]
        if any(end < start for start, end in zip(starts, self._ends, strict=False)):
            raise DataError(f"{path}: {ENDS} has to be non-decreasing")

    @property
    def extras(self) -> Extras:
        """The attributes of the store."""
        return self._extras

    def __len__(self) -> int:
        """The number of episodes."""
        return len(self._ends)

    def __getitem__(self, index: int) -> DiffusionEpisode:
        """Return an episode by its index."""
        position = range(len(self._ends))[index]
        start = self._ends[position - 1] if position else 0
        return DiffusionEpisode(self, position, (start, self._ends[position]))

    def rows(self, name: str, start: int, stop: int) -> np.ndarray:
        """Return rows of an array, counted over the whole dataset."""
        with _data_errors(self._path):
            rows: np.ndarray = np.asarray(self._store["data"][name][start:stop])
        if len(rows) != stop - start:
            raise DataError(f"{self._path}: {name} has {len(rows)} of the rows {start} to {stop}")
        return rows


class DiffusionEpisode(OutlinedEpisode):
    """The rows of one episode."""

    def __init__(self, owner: DiffusionSet, index: int, span: tuple[int, int]) -> None:
        super().__init__(f"episode_{index:06d}")
        self._owner = owner
        self._start, self._stop = span

    def outline(self) -> Outline:
        """Read everything but rows and images."""
        contents = self._owner.contents.items()
        columns = {name: one for name, one in contents if isinstance(one, ColumnInfo)}
        cameras = {name: one for name, one in contents if isinstance(one, CameraInfo)}
        return Outline(self._stop - self._start, (), columns, cameras)

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        if column not in self.columns:
            raise KeyError(column)
        first, last, _ = slice(start, stop).indices(self.length)
        return self._owner.rows(column, self._start + first, self._start + max(first, last))

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        if camera not in self.cameras:
            raise KeyError(camera)
        for index in range(*slice(start, stop).indices(self.length)):
            image = self._owner.rows(camera, self._start + index, self._start + index + 1)[0]
            yield image if image.dtype == np.uint8 else np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _open_store(path: Path) -> Any:
    """Open the store after checking the metadata of every array."""
    zarr = libraries.zarr()
    for count, (name, text) in enumerate(_declarations(path), 1):
        if count > _MOST_ARRAYS:
            raise DataError(f"{path} has more than {_MOST_ARRAYS} arrays")
        _check(documents.parse_json(text, f"{path}: {name}"), f"{path}: {name}")
    with _data_errors(path):
        store = zarr.storage.ZipStore(path, mode="r") if path.suffix == ".zip" else str(path)
        return zarr.open_group(store, mode="r", zarr_format=2, use_consolidated=False)


@contextmanager
def _data_errors(path: Path) -> Iterator[None]:
    """Turn errors of zarr and its codecs into `DataError`."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:  # noqa: BLE001 - zarr and its codecs raise almost anything on damaged stores
        raise DataError(f"{path} cannot be read as zarr: {str(error)[:200]}") from None


def _declarations(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield the `.zarray` metadata of the arrays that are read, with their names in the store."""
    if path.is_dir():
        paths = [path / ENDS / _ARRAY, *sorted(path.glob(f"data/*/{_ARRAY}"))]
        for file in paths:
            try:
                yield file.relative_to(path).as_posix(), files.read_regular(file, _MOST_DECLARED)
            except FileNotFoundError:
                continue
            except OSError as error:
                raise DataError(f"{file} cannot be read: {error.strerror}") from None
        return
    try:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                if _READ.fullmatch(entry.filename):
                    with archive.open(entry) as stream:
                        yield entry.filename, stream.read(_MOST_DECLARED)
                elif entry.file_size > _MOST_CHUNK:
                    raise DataError(f"{path}: {entry.filename} claims {entry.file_size} bytes, over {_MOST_CHUNK}")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, zlib.error, EOFError) as error:
        raise DataError(f"{path} is no ZIP file that can be read: {str(error)[:200]}") from None


def _check(declared: Any, where: str) -> None:
    """Check an array's metadata before a chunk is read: some codecs execute code, and chunks can claim any size.

    Raises:
        DataError: the codec or type is not on the list of safe ones, or a chunk is too large.
    """
    documents.validate_value(declared, _ARRAY_SCHEMA, where)
    size = math.prod(declared["chunks"]) * int(declared["dtype"][2:])
    if size > _MOST_CHUNK:
        raise DataError(f"{where} has chunks of {size} bytes, more than {_MOST_CHUNK}")
    if where.endswith(f"{ENDS}/{_ARRAY}") and math.prod(declared["shape"]) > _MOST_EPISODES:
        raise DataError(f"{where} claims {math.prod(declared['shape'])} episodes, more than {_MOST_EPISODES}")


def _describe_array(name: str, array: Any) -> ColumnInfo | CameraInfo:
    """Classify an array: a camera if its rows are images of bytes, or of floats 0..255 as in Push-T, else a column."""
    shape, dtype = array.shape, np.dtype(array.dtype)
    if dtype.kind not in "biuf":
        raise DataError(f"{name} holds {dtype}, which is not read: texts and objects need pickle")
    if len(shape) == 4 and shape[3] == 3 and min(shape[1:3]) >= _SMALLEST and shape[1] * shape[2] <= PIXELS:
        return CameraInfo(shape[1], shape[2], encoding="raw" if dtype == np.uint8 else dtype.name)
    return ColumnInfo(tuple(shape[1:]), dtype.name)
