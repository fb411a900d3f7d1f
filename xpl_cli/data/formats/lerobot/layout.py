"""File layout of a LeRobot dataset, and the metadata in `meta/`.

Source: LeRobot 0.3 (v2.1) and 0.4 (v3.0), lerobot/datasets/utils.py and lerobot_dataset.py.
"""

from __future__ import annotations

import collections
import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.basics import files
from xpl_cli.data.formats import libraries
from xpl_cli.data.sets import documents
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import Extras

INFO: Final = "meta/info.json"
V21: Final = "v2.1"
V30: Final = "v3.0"
DEFAULTS: Final = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Scalar columns that every dataset has."""
DATA_PATH: Final = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH: Final = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES: Final = "meta/episodes"
EPISODES_PATH: Final = EPISODES + "/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
CHUNKS_SIZE: Final = 1000
"""Most files per folder."""
EXTRAS: Final = "extras"
"""Key of metadata that LeRobot has no field for: in info.json, and as JSON text of each episode."""
_TEMPLATE_FIELD: Final = re.compile(r"\{([a-z_]+)(?::0?([0-9])d)?\}")
_MOST_META: Final = 512 << 20
_FEW_ROWS: Final = 1000
_ROW_BYTES: Final = 8
"""Fewest bytes of the episode table per row: each row has another start index."""
_POINTERS: Final = ("data/", "meta/", "videos/", "stats/")
_NAMED: Final = ("codebase_version", "features", "fps", "robot_type", "data_path", "video_path")
_COUNTS: Final = ("chunks_size", "data_files_size_in_mb", "video_files_size_in_mb", "splits")
_COUNT: Final = {"type": "integer", "minimum": 0, "maximum": 1 << 40}
_STEPS: Final = {"type": "integer", "minimum": 1, "maximum": 1 << 31}
_MAP: Final = {"type": ["object", "null"]}
_FEATURE: Final = {
    "type": "object",
    "required": ["dtype", "shape"],
    "properties": {
        "dtype": {"type": "string"},
        "shape": {"type": "array", "maxItems": 8, "items": _COUNT},
        "names": {"type": ["array", "object", "null"]},
        "info": _MAP,
        "video_info": _MAP,
    },
}
_INFO_SCHEMA: Final = documents.schema_text(
    {
        "type": "object",
        "required": ["features", "fps", "data_path"],
        "properties": {
            "features": {"type": "object", "additionalProperties": _FEATURE},
            "fps": {"type": "number", "exclusiveMinimum": 0, "maximum": 1_000_000},
            "data_path": {"type": "string"},
            "video_path": {"type": ["string", "null"]},
            "chunks_size": {"type": ["integer", "null"], "minimum": 1},
        },
    }
)
"""The keys of `meta/info.json` that are read; others are kept unchanged."""
_EPISODE_SCHEMA: Final = documents.schema_text(
    {
        "type": "object",
        "required": ["episode_index", "length"],
        "properties": {"episode_index": _COUNT, "length": _STEPS, "tasks": {"type": ["array", "null"]}},
    }
)
_ROW_SCHEMA: Final = documents.schema_text(
    {
        "type": "object",
        "required": ["episode_index", "length", "dataset_from_index"],
        "properties": {
            "episode_index": _COUNT,
            "length": _STEPS,
            "dataset_from_index": _COUNT,
            "tasks": {"type": ["array", "null"]},
        },
    }
)
_KNOWN: Final = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index")


@dataclass(frozen=True)
class EpisodeEntry:
    """The metadata of one episode.

    Attributes:
        index: its number.
        length: steps.
        tasks: language instructions.
        data: path of its parquet file, relative to the root.
        first: its first row in that file.
        videos: by camera, the video's path relative to the root and the episode's start in it, seconds.
        extras: other metadata.
    """

    index: int
    length: int
    tasks: tuple[str, ...]
    data: str
    first: int
    videos: Mapping[str, tuple[str, float]]
    extras: Extras = field(default_factory=dict)


@dataclass(frozen=True)
class Feature:
    """A column or camera in `meta/info.json`.

    Attributes:
        dtype: `video`, `image`, `string`, or numpy's name of a type.
        shape: of a row or an image; datasets of 2024 have an image's channels first.
        names: of the numbers of a row, or of the axes of an image; empty if not given.
        codec: of a video; "" if not given.
    """

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...]
    codec: str = ""

    @property
    def is_camera(self) -> bool:
        """Whether it holds images."""
        return self.dtype in ("video", "image")


@dataclass(frozen=True)
class Info:
    """The content of `meta/info.json`.

    Attributes:
        version: v2.1 or v3.0, which sets the file layout.
        rate_hz: steps per second.
        robot: the robot's name in the dataset; None if not given.
        features: by name.
        data_path, video_path: templates of the paths of files.
        chunk: most episodes per folder, in v2.1.
        rest: other metadata, without counts.
    """

    version: str
    rate_hz: float
    robot: str | None
    features: Mapping[str, Feature]
    data_path: str
    video_path: str
    chunk: int
    rest: Extras

    @property
    def videos(self) -> list[str]:
        """The names of the cameras that are videos."""
        return [name for name, feature in self.features.items() if feature.dtype == "video"]


def read_info(root: Path) -> Info:
    """Read `meta/info.json`.

    Raises:
        DataError: the file cannot be read, or has an invalid value.
    """
    path = root / INFO
    info = documents.validate_value(documents.parse_json(_text(path), str(path)), _INFO_SCHEMA, str(path))
    extras = info.get(EXTRAS)
    used_keys = (*_NAMED, *_COUNTS, EXTRAS)
    rest = {key: value for key, value in info.items() if key not in used_keys and not key.startswith("total_")}
    return Info(
        version=_version(root, str(info.get("codebase_version"))),
        rate_hz=float(info["fps"]),
        robot=str(info.get("robot_type") or "") or None,
        features={name: _feature(entry) for name, entry in info["features"].items()},
        data_path=info["data_path"],
        video_path=str(info.get("video_path") or ""),
        chunk=info.get("chunks_size") or CHUNKS_SIZE,
        rest={**(extras if isinstance(extras, dict) else {}), **rest},
    )


def _feature(entry: Mapping[str, Any]) -> Feature:
    names = entry.get("names")
    if isinstance(names, dict):  # lists in a map such as `motors`
        names = [one for value in names.values() if isinstance(value, list) for one in value]
    about = entry.get("info") or entry.get("video_info") or {}
    codec = about.get("video.codec")
    labels = tuple(map(str, names)) if isinstance(names, list) else ()
    return Feature(entry["dtype"], tuple(entry["shape"]), labels, str(codec or ""))


def _version(root: Path, stated: str) -> str:
    """Return v2.1 or v3.0, which sets the file layout."""
    if stated.startswith("v3."):
        return V30
    if stated.startswith("v2."):
        return V21
    raise DataError(f"{root / INFO} has version {stated[:40]}; supported are v2.0, v2.1 and v3.0")


def read_entries(root: Path, info: Info) -> list[EpisodeEntry]:
    """Read the metadata of the episodes, ordered by episode index.

    Raises:
        DataError: a file below `meta/` cannot be read, or lacks a key.
    """
    try:
        entries = list(_entries_of_lines(root, info) if info.version == V21 else _entries_of_tables(root, info))
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{root}: the lists of episodes below meta/ are damaged: {error!r:.200}") from None
    _refuse_shared_rows(root, entries)
    return sorted(entries, key=lambda entry: entry.index)


def _refuse_shared_rows(root: Path, entries: list[EpisodeEntry]) -> None:
    """Check that no episode index occurs twice and that no table row belongs to two episodes.

    Raises:
        DataError: one does.
    """
    for index, count in collections.Counter(entry.index for entry in entries).items():
        if count > 1:
            raise DataError(f"{root}: below meta/ the episode {index} is listed {count} times, expected once")
    for one, other in itertools.pairwise(sorted(entries, key=lambda entry: (entry.data, entry.first))):
        if one.data == other.data and one.first + one.length > other.first:
            raise DataError(
                f"{root}: below meta/ the episodes {one.index} and {other.index} both have row {other.first} of "
                f"{one.data}, expected each row in one"
            )


def read_statistics(root: Path, version: str, feature: str) -> dict[int, dict[str, Any]]:
    """Return the statistics of a feature by episode, for the episodes that have them.

    Raises:
        DataError: a file below `meta/` cannot be read.
    """
    if version == V21:
        path = root / "meta/episodes_stats.jsonl"
        records = lines(path) if path.is_file() else iter(())
        by_episode = {line.get("episode_index"): (line.get("stats") or {}).get(feature) for line in records}
        return {int(index): stats for index, stats in by_episode.items() if isinstance(index, int) and stats}
    prefix = f"stats/{feature}/"
    return {
        int(row["episode_index"]): {key.removeprefix(prefix): row[key] for key in row if key.startswith(prefix)}
        for row in _rows(root, prefix)
    }


def fill_path(template: str, values: Mapping[str, Any]) -> str:
    """Fill a path template with values.

    Raises:
        DataError: the path leads out of the dataset, or the template has a field without a value.
    """

    def put(match: re.Match[str]) -> str:
        value = values[match[1]]
        return str(value) if match[2] is None else f"{int(value):0{match[2]}d}"

    try:
        path = _TEMPLATE_FIELD.sub(put, template)
    except KeyError as error:
        raise DataError(f"{INFO}: the path {template[:200]!r} has the unknown field {error}") from None
    if "{" in path or path.startswith("/") or ".." in Path(path).parts or "\0" in path:
        raise DataError(f"{INFO}: the path {template[:200]!r} leads out of the dataset, or is damaged")
    return path


def lines(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the objects of a file of JSON lines.

    Raises:
        DataError: the file cannot be read, or a line is no JSON object.
    """
    for number, line in enumerate(_text(path).splitlines(), 1):
        if not line.strip():
            continue
        where = f"{path}, line {number}"
        value = documents.parse_json(line, where)
        if not isinstance(value, dict):
            raise DataError(f"{where}: expected an object of JSON")
        yield value


def object_of(text: str, where: str) -> dict[str, Any]:
    """Parse a JSON object.

    Raises:
        DataError: the text is none.
    """
    value = documents.parse_json(text, f"{where}: {EXTRAS}")
    if not isinstance(value, dict):
        raise DataError(f"{where}: {EXTRAS} is no object of JSON")
    return value


def _entries_of_lines(root: Path, info: Info) -> Iterator[EpisodeEntry]:
    path = root / "meta/episodes.jsonl"
    for number, line in enumerate(lines(path), 1):
        documents.validate_value(line, _EPISODE_SCHEMA, f"{path}, episode {number}")
        index = line["episode_index"]
        values = {"episode_index": index, "episode_chunk": index // info.chunk}
        yield EpisodeEntry(
            index,
            line["length"],
            tuple(map(str, line.get("tasks") or ())),
            fill_path(info.data_path, values),
            0,
            {name: (fill_path(info.video_path, {**values, "video_key": name}), 0.0) for name in info.videos},
            {key: value for key, value in line.items() if key not in _KNOWN},
        )


def _entries_of_tables(root: Path, info: Info) -> Iterator[EpisodeEntry]:
    read = enumerate(_rows(root), 1)
    checked = (documents.validate_value(row, _ROW_SCHEMA, f"{root / EPISODES}, row {number}") for number, row in read)
    rows = sorted(checked, key=lambda row: int(row["episode_index"]))
    begins: dict[str, int] = {}
    for row in rows:
        path = fill_path(info.data_path, _pointer(row, "data"))
        begins.setdefault(path, int(row["dataset_from_index"]))
        begins[path] = min(begins[path], int(row["dataset_from_index"]))
    for row in rows:
        path = fill_path(info.data_path, _pointer(row, "data"))
        yield EpisodeEntry(
            int(row["episode_index"]),
            int(row["length"]),
            tuple(map(str, row.get("tasks") or ())),
            path,
            int(row["dataset_from_index"]) - begins[path],
            {
                name: (
                    fill_path(info.video_path, {**_pointer(row, f"videos/{name}"), "video_key": name}),
                    float(row[f"videos/{name}/from_timestamp"]),
                )
                for name in info.videos
            },
            {key: value for key, value in row.items() if key not in _KNOWN and not key.startswith(_POINTERS)},
        )


def _pointer(row: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {name: int(row[f"{prefix}/{name}"]) for name in ("chunk_index", "file_index")}


def _rows(root: Path, statistics: str = "") -> Iterator[dict[str, Any]]:
    """Yield the rows of the episode tables: without statistics, or only the statistics whose names have a prefix."""
    parquet = libraries.parquet()
    paths = sorted((root / EPISODES).glob("*/*.parquet"))
    if not paths:
        raise DataError(f"{root / EPISODES} has no table of episodes")
    for path in paths:
        try:
            with parquet.ParquetFile(path) as file:
                count, size = file.metadata.num_rows, path.stat().st_size
                if count > _FEW_ROWS + size // _ROW_BYTES:
                    raise DataError(f"{path} claims {count} rows, more than its {size} bytes hold")
                names = [name for name in file.schema_arrow.names if not name.startswith("stats/")]
                if statistics:
                    names = ["episode_index"] + [n for n in file.schema_arrow.names if n.startswith(statistics)]
                for batch in file.iter_batches(columns=names):
                    yield from batch.to_pylist()
        except (OSError, libraries.arrow().ArrowException) as error:
            raise DataError(f"{path} cannot be read: {str(error)[:200]}") from None


def _text(path: Path) -> str:
    try:
        return files.read_regular(path, _MOST_META).decode()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DataError(f"{path} is no text") from None
