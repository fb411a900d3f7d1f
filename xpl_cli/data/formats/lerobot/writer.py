"""Writer of LeRobot datasets, v3.0: one file per episode first, then joined to files of many episodes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import image_codec
from xpl_cli.basics.atomic import write_file
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.formats import image_files, video, video_encoding
from xpl_cli.data.formats.lerobot import layout, stats, tables
from xpl_cli.data.formats.lerobot.layout import Feature
from xpl_cli.data.formats.writing import NamingScheme, WrittenEpisode
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl_cli.data.formats.writing import WritePlan
    from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, RecordedEpisode

_SET, _EPISODES = "set", "episodes"
_IMAGES: Final = ("auto", "video", "png")
_SAMPLED: Final = 8
"""Frames of each video that are decoded again, to measure the loss."""
_EXACT: Final = 100.0
"""PSNR in dB that stands for identical frames."""
_MB: Final = 1 << 20
_DATA_MB, _VIDEO_MB = 100.0, 200.0


class LeRobotWriter:
    """Writes v3.0."""

    name = f"lerobot-{layout.V30}"
    names = NamingScheme(
        "action", "observation.state", "observation.", "observation.images.", ".", "observation.environment_state"
    )

    def column_rejection(self, column: ColumnInfo) -> str | None:
        """Return why the format cannot hold a column; None if it can."""
        if len(column.shape) > 5:
            return f"LeRobot takes arrays of 5 axes at most, this has {len(column.shape)}"
        return "it is empty" if 0 in column.shape else None

    def camera_rejection(self, camera: CameraInfo) -> str | None:
        """Return why the format cannot hold a camera; None if it can."""
        return None if camera.kind == "color" else "LeRobot datasets have no depth images"

    def check(self, plan: WritePlan) -> None:
        """Check the plan before anything is written."""
        if plan.options.images not in _IMAGES:
            raise DataError(
                f"LeRobot stores images as video or png, got --images {plan.options.images}",
                code=ExitCode.USAGE,
            )
        if plan.rate_hz is None:
            raise DataError("LeRobot needs the steps per second, which this dataset lacks", hint="give --rate HZ")
        if 0 in plan.lengths:
            raise DataError(f"the episode {plan.lengths.index(0)} has no steps; LeRobot needs one at least")
        wrong = [name for name in (*plan.columns, *plan.cameras) if "/" in name]
        if wrong:
            raise DataError(f"LeRobot takes no / in names, got {', '.join(wrong)}")

    def write_episode(self, folder: Path, plan: WritePlan, index: int, episode: RecordedEpisode) -> WrittenEpisode:
        """Write the numbers and videos of one episode."""
        _require_same_features(plan, index, episode)
        rate = float(plan.rate_hz or 0)
        statistics: dict[str, stats.Stats] = {}
        columns: dict[str, Any] = {}
        for name in plan.columns:
            rows = episode.read(name)
            columns[name] = rows
            if rows.dtype.kind in "biuf":
                statistics[name] = stats.of_numbers(rows)
        videos: dict[str, str] = {}
        psnr_db: dict[str, float] = {}
        for name in plan.cameras:
            if _is_video(plan, name):
                path = _video_path(folder, index, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                videos[name], worst, statistics[name] = _write_video(path, episode, name, plan, rate)
                psnr_db |= {} if worst is None else {name: worst}
            else:
                columns[name], statistics[name] = _pngs(episode, name)
        columns |= _default_columns(plan, index, rate, _tasks(plan))
        statistics |= {name: stats.of_numbers(columns[name]) for name in layout.DEFAULTS}
        path = _table_path(folder, index)
        path.parent.mkdir(parents=True, exist_ok=True)
        tables.write(path, tables.schema(_features(plan)), columns)
        return WrittenEpisode(psnr_db, videos, statistics, dict(episode.extras))

    def finish(self, folder: Path, plan: WritePlan, pieces: list[WrittenEpisode]) -> Path:
        """Join the episodes' files, and write `meta/`."""
        result = folder / _SET
        if result.exists():  # an earlier run was interrupted here
            shutil.rmtree(result)
        meta = result / "meta"
        meta.mkdir(parents=True, exist_ok=True)
        rows = [_row(plan, index, piece) for index, piece in enumerate(pieces)]
        tasks = list(_tasks(plan))
        starts = plan.starts
        for index, location in enumerate(_join_files(folder, plan)):
            rows[index] |= location
            rows[index]["dataset_from_index"] = starts[index]
            rows[index]["dataset_to_index"] = starts[index] + plan.lengths[index]
            rows[index] |= {f"meta/episodes/{key}": value for key, value in _file(0).items()}
        tables.write_tasks(meta / "tasks.parquet", tasks)
        tables.write_episodes(result / layout.fill_path(layout.EPISODES_PATH, _file(0)), rows, pieces)
        write_file(meta / "stats.json", _json(stats.of_all([piece.stats for piece in pieces])))
        write_file(result / layout.INFO, _json(_info_json(plan, pieces, tasks)))
        return result


def _info_json(plan: WritePlan, pieces: list[WrittenEpisode], tasks: list[str]) -> dict[str, Any]:
    """Return `meta/info.json`."""
    rate = float(plan.rate_hz or 0)
    features: dict[str, dict[str, Any]] = {
        name: {"dtype": feature.dtype, "shape": list(feature.shape), "names": list(feature.names) or None}
        for name, feature in _features(plan).items()
    }
    for name, codec in pieces[0].videos.items():
        features[name]["info"] = {
            "video.height": plan.cameras[name].height,
            "video.width": plan.cameras[name].width,
            "video.codec": codec,
            "video.pix_fmt": "yuv420p",
            "video.is_depth_map": False,
            "video.fps": _integer_if_whole(rate),
            "video.channels": 3,
            "has_audio": False,
        }
    has_video = any(_is_video(plan, name) for name in plan.cameras)
    info: dict[str, Any] = {
        "codebase_version": layout.V30,
        "robot_type": plan.robot,
        "total_episodes": len(pieces),
        "total_frames": sum(plan.lengths),
        "total_tasks": len(tasks),
        "chunks_size": layout.CHUNKS_SIZE,
        "fps": _integer_if_whole(rate),
        "splits": {"train": f"0:{len(pieces)}"},
        "data_path": layout.DATA_PATH,
        "video_path": layout.VIDEO_PATH if has_video else None,
        "features": features,
    }
    info |= {"data_files_size_in_mb": int(_DATA_MB), "video_files_size_in_mb": int(_VIDEO_MB)}
    if plan.extras:
        info[layout.EXTRAS] = dict(plan.extras)
    return info


def _join_files(folder: Path, plan: WritePlan) -> list[dict[str, Any]]:
    """Join the episodes' files; return the location of each episode, as columns of the episode table."""
    rate = float(plan.rate_hz or 0)
    result = folder / _SET
    locations: list[dict[str, Any]] = [{} for _ in plan.lengths]
    each = range(len(plan.lengths))
    paths = [_table_path(folder, index) for index in each]
    for number, indices in enumerate(_groups_by_size(paths, plan.options.file_mb or _DATA_MB)):
        target = result / layout.fill_path(layout.DATA_PATH, _file(number))
        target.parent.mkdir(parents=True, exist_ok=True)
        tables.join(target, [paths[index] for index in indices])
        for index in indices:
            locations[index] |= {f"data/{key}": value for key, value in _file(number).items()}
    for name in (camera for camera in plan.cameras if _is_video(plan, camera)):
        paths = [_video_path(folder, index, name) for index in each]
        for number, indices in enumerate(_groups_by_size(paths, plan.options.file_mb or _VIDEO_MB)):
            target = result / layout.fill_path(layout.VIDEO_PATH, {**_file(number), "video_key": name})
            target.parent.mkdir(parents=True, exist_ok=True)
            video_encoding.join_videos(target, [(paths[index], plan.lengths[index]) for index in indices], rate)
            begins = 0
            for index in indices:
                location = locations[index]
                location |= {f"videos/{name}/{key}": value for key, value in _file(number).items()}
                location[f"videos/{name}/from_timestamp"] = begins / rate
                begins += plan.lengths[index]
                location[f"videos/{name}/to_timestamp"] = begins / rate
    return locations


def _write_video(
    path: Path, episode: RecordedEpisode, name: str, plan: WritePlan, rate: float
) -> tuple[str, float | None, stats.Stats]:
    """Write a camera's video; copy it where the source is a video already.

    Returns:
        codec, lowest PSNR of the sampled frames in dB (None for a copy), and statistics.
    """
    steps = stats.sampled_steps(episode.length)
    source = episode.video(name)
    if source is not None and video_encoding.copy_video(Path(source.path), source.begins_s, rate, episode.length, path):
        statistics = _video_statistics(episode, name, steps)
        return source.codec, None, statistics
    sampled: list[NDArray[np.uint8]] = []

    def frames_with_sampling() -> Iterator[NDArray[np.uint8]]:
        due_steps = iter([*steps, -1])
        due = next(due_steps)
        for index, frame in enumerate(episode.frames(name)):
            while index == due:
                sampled.append(stats.downsample(frame))
                due = next(due_steps)
            yield np.ascontiguousarray(frame)

    video_encoding.encode_video(path, frames_with_sampling(), rate, plan.options.codec, plan.options.crf)
    sample = min(episode.length, _SAMPLED)
    back = video.frames(path, 0.0, rate, 0, sample)
    worst = min(image_files.psnr(one, other) for one, other in zip(episode.frames(name, 0, sample), back, strict=True))
    return plan.options.codec, min(worst, _EXACT), stats.of_images(sampled)


def _video_statistics(episode: RecordedEpisode, name: str, steps: list[int]) -> stats.Stats:
    """Return the statistics of a copied video: the dataset's own, else computed from sampled frames."""
    recorded = episode.stats(name)
    if recorded is not None:
        return dict(recorded)
    chosen_steps = set(steps)
    return stats.of_images(
        [stats.downsample(frame) for index, frame in enumerate(episode.frames(name)) if index in chosen_steps]
    )


def _pngs(episode: RecordedEpisode, name: str) -> tuple[list[dict[str, Any]], stats.Stats]:
    """Return a camera's images for the table, and their statistics."""
    steps = set(stats.sampled_steps(episode.length))
    rows, sampled = [], []
    for index, frame in enumerate(episode.frames(name)):
        rows.append({"bytes": image_codec.encode_png(frame), "path": f"frame-{index:06d}.png"})
        if index in steps:
            sampled.append(stats.downsample(frame))
    return rows, stats.of_images(sampled)


def _default_columns(plan: WritePlan, index: int, rate: float, tasks: Mapping[str, int]) -> dict[str, Any]:
    """Return the default columns of an episode."""
    length = plan.lengths[index]
    steps = np.arange(length, dtype=np.int64)
    instructions = plan.instructions[index]
    return {
        "timestamp": (steps / rate).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full(length, index, np.int64),
        "index": steps + plan.starts[index],
        "task_index": np.full(length, tasks[instructions[0] if instructions else ""], np.int64),
    }


def _tasks(plan: WritePlan) -> dict[str, int]:
    """Return the task index of each instruction; LeRobot needs one for each step, possibly an empty one."""
    first = dict.fromkeys(sentences[0] if sentences else "" for sentences in plan.instructions)
    others = dict.fromkeys(sentence for sentences in plan.instructions for sentence in sentences)
    return {sentence: number for number, sentence in enumerate(first | others)}


def _is_video(plan: WritePlan, camera: str) -> bool:
    """Tell whether a camera's images become a video; by default PNG images stay PNG, and so exact."""
    form = plan.options.images
    return form == "video" or (form == "auto" and plan.cameras[camera].encoding != "png")


def _features(plan: WritePlan) -> dict[str, Feature]:
    """Return the features of info.json."""
    features: dict[str, Feature] = {}
    for name, column in plan.columns.items():
        dtype = "string" if column.dtype == "str" else column.dtype
        features[name] = Feature(dtype, column.shape or (1,), column.names)
    for name, camera in plan.cameras.items():
        dtype = "video" if _is_video(plan, name) else "image"
        features[name] = Feature(dtype, (camera.height, camera.width, 3), ("height", "width", "channels"))
    return features | {name: Feature(dtype, (1,), ()) for name, dtype in layout.DEFAULTS.items()}


def _row(plan: WritePlan, index: int, piece: WrittenEpisode) -> dict[str, Any]:
    """Return the version-independent columns of an episode's metadata."""
    row: dict[str, Any] = {
        "episode_index": index,
        "tasks": list(plan.instructions[index]) or [""],
        "length": plan.lengths[index],
    }
    if piece.extras:
        row[layout.EXTRAS] = json.dumps(piece.extras, ensure_ascii=False)
    return row


def _require_same_features(plan: WritePlan, index: int, episode: RecordedEpisode) -> None:
    """Check that an episode has the features of the first one, as LeRobot requires."""
    where = f"the episode {episode.key} (number {index})"
    for name in (*plan.columns, *plan.cameras):
        if name not in episode.columns and name not in episode.cameras:
            raise DataError(f"{where} has no {name}, which the first one has")
    for name, first in plan.columns.items():
        has = episode.columns[name]
        if (has.shape, has.dtype) != (first.shape, first.dtype):
            raise DataError(
                f"{where} has {has.shape} {has.dtype} in each row of {name}, the first one {first.shape} {first.dtype}"
            )
    for name, first_camera in plan.cameras.items():
        camera = episode.cameras[name]
        if (camera.height, camera.width) != (first_camera.height, first_camera.width):
            raise DataError(
                f"{where} has images of {camera.height} x {camera.width} in {name}, "
                f"the first one of {first_camera.height} x {first_camera.width}"
            )


def _groups_by_size(paths: list[Path], most_mb: float) -> Iterator[list[int]]:
    """Yield indices of files that together have at most `most_mb` MB, or of a single larger file."""
    group: list[int] = []
    size = 0
    for index, path in enumerate(paths):
        this = path.stat().st_size
        if group and size + this > most_mb * _MB:
            yield group
            group, size = [], 0
        group.append(index)
        size += this
    if group:
        yield group


def _file(number: int) -> dict[str, int]:
    return {"chunk_index": number // layout.CHUNKS_SIZE, "file_index": number % layout.CHUNKS_SIZE}


def _table_path(folder: Path, index: int) -> Path:
    return folder / _EPISODES / "data" / f"{index:06d}.parquet"


def _video_path(folder: Path, index: int, camera: str) -> Path:
    return folder / _EPISODES / "videos" / camera / f"{index:06d}.mp4"


def _integer_if_whole(rate: float) -> float:
    return int(rate) if rate.is_integer() else rate


def _json(value: object) -> bytes:
    return json.dumps(value, indent=4, ensure_ascii=False).encode()
