"""Reader of LeRobot datasets: rows of parquet files, frames of videos or of images in the tables."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl.image_codec import PIXELS
from xpl.trajectory import storage
from xpl_cli.data.formats import image_files, libraries, video
from xpl_cli.data.formats.lerobot import layout
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Demonstrations, Extras, VideoClip
from xpl_cli.data.sets.outlined import Outline, OutlinedEpisode

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_ROW: Final = 64 << 20
"""Most bytes of one row of a column."""
_TYPES: Final = ("bool", *(f"{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)))
_NUMBERS: Final = (*_TYPES, "float16", "float32", "float64")


def recognises(path: Path) -> bool:
    """Tell whether a folder is a LeRobot dataset."""
    return (path / layout.INFO).is_file()


def opened(path: Path) -> LeRobotSet:
    """Return the dataset."""
    return LeRobotSet(path)


class LeRobotSet(Demonstrations):
    """A folder with `meta/info.json`."""

    def __init__(self, root: Path) -> None:
        self.root, self._info_path = root, root / layout.INFO
        self.info = layout.read_info(root)
        super().__init__(root, f"lerobot-{self.info.version}")

    @property
    def rate_hz(self) -> float | None:
        """Steps per second."""
        return self.info.rate_hz

    @property
    def robot(self) -> str | None:
        """The robot's name in the dataset, if it has one."""
        return self.info.robot

    @property
    def extras(self) -> Extras:
        """Other keys of `meta/info.json`, without counts."""
        return self.info.rest

    def __len__(self) -> int:
        """The number of episodes."""
        return len(self._entries)

    def __getitem__(self, index: int) -> LeRobotEpisode:
        """Return an episode by its index."""
        return LeRobotEpisode(self, self._entries[index])

    @functools.cached_property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The columns of every episode."""
        features = self.info.features.items()
        return {name: _column(self._info_path, name, feature) for name, feature in features if not feature.is_camera}

    @functools.cached_property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras of every episode."""
        features = self.info.features.items()
        return {name: _camera(self._info_path, name, feature) for name, feature in features if feature.is_camera}

    @functools.lru_cache(maxsize=8)  # noqa: B019 - a dataset lives as long as its reader
    def group(self, path: str, number: int, column: str) -> np.ndarray:
        """Return a column of one row group; episodes share row groups, which are decompressed as a whole."""
        with _opened(self.root / path) as file:
            self._require(file, column, path)
            return self._numbers(file.read_row_group(number, columns=[column]), column, path)

    @functools.lru_cache(maxsize=8)  # noqa: B019 - as above
    def _sizes(self, path: str) -> tuple[int, ...]:
        """Return the number of rows of each row group of a file."""
        with _opened(self.root / path) as file:
            return tuple(file.metadata.row_group(number).num_rows for number in range(file.metadata.num_row_groups))

    @functools.lru_cache(maxsize=16)  # noqa: B019 - as above
    def statistics(self, feature: str) -> dict[int, dict[str, Any]]:
        """Return the statistics of a feature by episode."""
        return layout.read_statistics(self.root, self.info.version, feature)

    def rows(self, entry: layout.EpisodeEntry, column: str, start: int, stop: int) -> np.ndarray:
        """Return rows of an episode."""
        pieces = []
        for number, first, last in _groups(self._sizes(entry.data), entry.first + start, entry.first + stop):
            pieces.append(self.group(entry.data, number, column)[first:last])
        count = sum(map(len, pieces))
        if count != stop - start:
            raise DataError(
                f"{self.root / entry.data} ends before the episode {entry.index} does: {column} has {count} of "
                f"{stop - start} rows"
            )
        return np.concatenate(pieces) if pieces else self._empty(column)

    def pictures(self, entry: layout.EpisodeEntry, camera: str, start: int, stop: int) -> Iterator[tuple[int, bytes]]:
        """Yield the encoded images of a camera that are stored in the table, with their step."""
        where = f"{self.root / entry.data}, {camera}"
        due = start
        with _opened(self.root / entry.data) as file:
            most = storage.most_read((self.root / entry.data).stat().st_size)
            self._require(file, camera, entry.data)
            for number, first, last in _groups(self._sizes(entry.data), entry.first + start, entry.first + stop):
                row = 0
                for batch in file.iter_batches(batch_size=16, row_groups=[number], columns=[camera]):
                    for value in batch.column(0).to_pylist():
                        if first <= row < last:
                            data = self._image(value, f"{where}, image {due}")
                            most -= len(data)
                            if most < 0:
                                raise DataError(f"{where}: up to image {due} they claim more than the file holds")
                            yield due, data
                            due += 1
                        row += 1
        if due != stop:
            raise DataError(f"{where} has {due} images, and {stop} are expected")

    @functools.cached_property
    def _entries(self) -> list[layout.EpisodeEntry]:
        return layout.read_entries(self.root, self.info)

    def _require(self, file: Any, column: str, path: str) -> None:
        if column not in file.schema_arrow.names:
            raise DataError(f"{self.root / path} has no column {column}, which {layout.INFO} lists")

    def _empty(self, column: str) -> np.ndarray:
        info = self.columns[column]
        return np.empty((0, *info.shape), info.dtype)

    def _numbers(self, table: Any, column: str, path: str) -> np.ndarray:
        """Return a column of a table as (rows, *shape)."""
        info = self.columns[column]
        values = table.column(0).combine_chunks()
        if info.dtype == "str":
            return np.array([str(value) for value in values.to_pylist()], dtype=str)
        arrow = libraries.arrow()
        values = getattr(values, "storage", values)  # an array of a type of `datasets`, where that is loaded
        while arrow.types.is_list(values.type) or arrow.types.is_fixed_size_list(values.type):
            values = _inner(values)
        flat = values.to_numpy(zero_copy_only=False)
        shape = (table.num_rows, *info.shape)
        if flat.size != math.prod(shape) or flat.dtype.kind not in "biuf":
            raise DataError(
                f"{self.root / path}: {column} holds {flat.size} {flat.dtype} in {table.num_rows} rows, "
                f"and {layout.INFO} says {info.shape} {info.dtype}"
            )
        rows: np.ndarray = flat.reshape(shape).astype(info.dtype, copy=False)
        return rows

    def _image(self, value: object, where: str) -> bytes:
        data = value.get("bytes") if isinstance(value, dict) else value
        if isinstance(data, bytes):
            return data
        raise DataError(f"{where} is not in the table; datasets with images in separate files are not supported")


class LeRobotEpisode(OutlinedEpisode):
    """An episode of a LeRobot dataset."""

    def __init__(self, owner: LeRobotSet, entry: layout.EpisodeEntry) -> None:
        super().__init__(f"episode_{entry.index:06d}")
        self._owner, self.entry = owner, entry

    def outline(self) -> Outline:
        """Return the outline from `meta/`; cameras are in the order of the features."""
        entry, extras = self.entry, self.entry.extras
        if isinstance(text := extras.get(layout.EXTRAS), str):
            rest = {key: value for key, value in extras.items() if key != layout.EXTRAS}
            extras = {**layout.object_of(text, f"{self._owner.root}, {self.key}"), **rest}
        return Outline(entry.length, entry.tasks, self._owner.columns, self._owner.cameras, extras)

    def video(self, camera: str) -> VideoClip | None:
        """Return a camera's video clip; None if its images are in the table."""
        if camera not in self.entry.videos:
            return None
        path, begins = self.entry.videos[camera]
        return VideoClip(str(self._owner.root / path), begins, self.cameras[camera].encoding)

    def stats(self, camera: str) -> dict[str, Any] | None:
        """Return the dataset's statistics of a camera's images; None if it has none."""
        statistics = self._owner.statistics(camera).get(self.entry.index)
        return statistics if statistics and {"min", "max", "mean", "std", "count"} <= set(statistics) else None

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        if column not in self.columns:
            raise KeyError(column)
        first, last, _ = slice(start, stop).indices(self.length)
        return self._owner.rows(self.entry, column, first, max(first, last))

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        feature = self._owner.info.features[camera]
        first, last, _ = slice(start, stop).indices(self.length)
        if feature.dtype == "video":
            path, begins = self.entry.videos[camera]
            yield from video.frames(self._owner.root / path, begins, self._owner.info.rate_hz, first, last)
            return
        for index, data in self._owner.pictures(self.entry, camera, first, last):
            yield image_files.decode_image(data, f"{self._owner.root / self.entry.data}, {camera}, image {index}")


def _camera(where: Path, name: str, feature: layout.Feature) -> CameraInfo:
    if len(feature.shape) != 3:
        raise DataError(f"{where}: the camera {name} has the shape {feature.shape}, expected three sizes")
    height, width = _sizes(feature)
    if height * width > PIXELS:
        raise DataError(f"{where}: images of {name} have {height} x {width} pixels, more than {PIXELS}")
    return CameraInfo(height, width, encoding="png" if feature.dtype == "image" else feature.codec or "video")


def _sizes(feature: layout.Feature) -> tuple[int, int]:
    """Return height and width; datasets of 2024 have the channels first, as their `names` show."""
    first, second, last = feature.shape
    is_first = feature.names[0].startswith("channel") if feature.names else first == 3 != last
    return (second, last) if is_first else (first, second)


def _column(where: Path, name: str, feature: layout.Feature) -> ColumnInfo:
    if feature.dtype in ("string", "large_string"):
        return ColumnInfo((), "str")
    if feature.dtype not in _NUMBERS:
        raise DataError(f"{where}: the feature {name} has the type {feature.dtype[:40]}, which is not read")
    shape = () if name in layout.DEFAULTS else feature.shape
    if math.prod(shape) * 8 > _MOST_ROW:
        raise DataError(f"{where}: the feature {name} has the shape {shape}, too large for a row")
    return ColumnInfo(shape, feature.dtype, feature.names if shape == (len(feature.names),) else ())


def _groups(sizes: Sequence[int], start: int, stop: int) -> Iterator[tuple[int, int, int]]:
    """Yield the row groups that hold rows `start` to `stop`, with the first row and the one after the last in each."""
    begins = 0
    for number, count in enumerate(sizes):
        first, last = max(start - begins, 0), min(stop - begins, count)
        if first < last:
            yield number, first, last
        begins += count


def _inner(values: Any) -> Any:
    """Return the values of an array of lists, one after the other."""
    if values.offset == 0 and values.null_count == 0 and len(values):
        inner = values.values
        size = getattr(values.type, "list_size", None)
        ends = [0, size * len(values)] if size is not None else [values.offsets[at].as_py() for at in (0, -1)]
        if ends == [0, len(inner)]:
            return inner
    return values.flatten()  # imports every compute function, which takes 0.2 s


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a parquet file; turn errors of pyarrow into `DataError`."""
    try:
        with libraries.parquet().ParquetFile(path) as file:
            yield file
    except (OSError, libraries.arrow().ArrowException) as error:
        raise DataError(f"{path} cannot be read as parquet: {str(error)[:200]}") from None
