"""The standard's own HDF5 format, which RoboDojo's datasets have; `xpl.trajectory` reads and writes it.

Source: spec/v1/trajectory.schema.json.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, cast

import numpy as np

from xpl import _spec as spec
from xpl import image_codec, json_text, trajectory
from xpl.trajectory import TrajectoryError, names
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.formats import hdf5, image_files, libraries
from xpl_cli.data.formats.folders import FolderSet, instructions_in
from xpl_cli.data.formats.writing import CONVERTED, NamingScheme, WrittenEpisode
from xpl_cli.data.sets import trajectory_schema
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo
from xpl_cli.data.sets.outlined import Outline, OutlinedEpisode

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl.trajectory import Trajectory
    from xpl_cli.data.formats.writing import WritePlan
    from xpl_cli.data.sets.interface import RecordedEpisode

NAME: Final = "xpl"
_SET: Final = "set"
_SAMPLED: Final = 16
"""Every 16th image is decoded again, to measure the loss."""
_FACTS: Final = f"{spec.Trajectory.ADDITIONAL_INFO}/{names.EPISODE}"
_OWN: Final = (
    *(spec.Trajectory.INSTRUCTION, spec.Trajectory.INSTRUCTIONS, spec.Trajectory.SUBTASKS),
    *(spec.Trajectory.DATA_FORMAT_VERSION, f"{spec.Trajectory.ADDITIONAL_INFO}/{spec.Obs.FREQUENCY}", _FACTS),
)
"""Metadata that has a key of its own in the standard's files."""
_BESIDE: Final = frozenset((spec.Trajectory.VISION, spec.Trajectory.ACTION))
"""Groups of which at least one accompanies the state."""
_MATRICES: Final = {spec.Camera.INTRINSIC_MATRIX: 3, spec.Camera.EXTRINSICS_MATRIX: 4}
"""Matrices stored beside a camera's images, with their number of rows and columns."""


def recognises(path: Path) -> bool:
    """Tell whether a path is a dataset of this format."""
    return hdf5.is_hdf5_set(path, lambda file: spec.Trajectory.STATE in file and not _BESIDE.isdisjoint(file))


def opened(path: Path) -> FolderSet:
    """Return the dataset; an index file beside the episodes is not read."""
    files = hdf5.OpenFileCache(trajectory.Trajectory)
    return FolderSet(path, NAME, hdf5.files(path), lambda file, key: _StandardFileEpisode((file, files), key))


class _StandardFileEpisode(OutlinedEpisode):
    """An episode. Images are read through a separate file handle, open while they are read."""

    def __init__(self, file: tuple[Path, hdf5.OpenFileCache[Trajectory]], key: str) -> None:
        super().__init__(key)
        self._path, self._files = file

    @functools.cached_property
    def length(self) -> int:
        """The number of steps."""
        with self._files.opened(self._path) as file:
            return len(file)

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        self.columns[column]  # raises KeyError for another column
        with self._files.opened(self._path) as file:
            return file.rows(column, start, stop)

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images of a camera; JPEGs become RGB by the standard's rule: swapped unless marked."""
        self.cameras[camera]
        with trajectory.Trajectory(str(self._path)) as file, hdf5.data_errors(file.path):
            yield from file.frames(camera, start, stop)

    def outline(self) -> Outline:
        """Read everything but rows and images."""
        with self._files.opened(self._path) as file:
            columns = {name: ColumnInfo(shape, dtype) for name, (shape, dtype) in file.columns.items()}
            cameras = {name: _camera(file, name, picture) for name, picture in file.pictures.items()}
            extras = file.rest
            instructions = tuple(one for one in file.instructions if one.strip())
            try:
                facts = file.episode
            except TrajectoryError:  # a third-party file that uses the key differently
                facts = {}
            else:
                extras.pop(_FACTS, None)
            extras |= facts
            length = len(file)
        return Outline(length, instructions or instructions_in(extras), columns, cameras, extras)


def _camera(file: Trajectory, name: str, picture: trajectory.ImageSeries) -> CameraInfo:
    beside = tuple(name.split("/")[:-1])
    matrices = {
        names.observation_path(path)[-1]: file.rows("/".join(path))
        for path in file.datasets
        if path[:-1] == beside and names.is_image(path, *_MATRICES)
    }
    return CameraInfo(
        picture.height,
        picture.width,
        cast("Literal['color', 'depth']", picture.kind),
        picture.encoding,
        *(matrices.get(leaf) for leaf in _MATRICES),
    )


class StandardWriter:
    """Writes the standard's files, one per episode; other formats need a mapping to its columns."""

    name = NAME
    names = NamingScheme("", "", "", f"{spec.Trajectory.VISION}/")

    def column_rejection(self, column: ColumnInfo) -> str | None:
        """Return None: HDF5 takes every column."""
        del column
        return None

    def camera_rejection(self, camera: CameraInfo) -> str | None:
        """Return None: HDF5 takes every camera."""
        del camera
        return None

    def check(self, plan: WritePlan) -> None:
        """Stop before anything is written."""
        if _form(plan) not in trajectory.FORMS:
            raise DataError(
                f"{self.name} stores images in HDF5; --images takes {', '.join(trajectory.FORMS)} here",
                code=ExitCode.USAGE,
            )
        used_names = {*plan.columns, *plan.cameras}
        for name in used_names:
            groups = itertools.accumulate(name.split("/")[:-1], "{}/{}".format)
            if clash := next((group for group in groups if group in used_names), None):
                raise DataError(f"HDF5 cannot hold both {clash} and {name}: one would be inside the other")
        parts = (f"{spec.Trajectory.STATE}/", f"{spec.Trajectory.ACTION}/")
        if not any(name.startswith(parts) for name in plan.columns):
            raise DataError(
                f"the standard's format needs columns below state/ or action/, got {', '.join(plan.columns)}",
                hint="map them with --map MAPPING; libero, aloha and robotwin are bundled",
            )

    def write_episode(self, folder: Path, plan: WritePlan, index: int, episode: RecordedEpisode) -> WrittenEpisode:
        """Write one episode's file."""
        libraries.h5py()
        path, form = folder / _SET / f"episode_{index}.hdf5", _form(plan)
        for left in path.parent.glob(f".{path.name}.*"):  # by a run that was killed
            left.unlink()
        beside = _beside_images(episode)
        facts = {key: value for key, value in episode.extras.items() if key not in (*_OWN, *beside)}
        facts |= {"robot": plan.robot} if plan.robot is not None else {}
        facts[CONVERTED] = plan.extras.get(CONVERTED, {})
        samples: dict[str, list[float]] = {}
        try:
            with trajectory.Writer(path, images=form, frequency=plan.rate_hz, episode=facts) as writer:
                for name, column in episode.columns.items():
                    rows = episode.read(name)
                    writer.put(name, rows.tolist() if column.dtype == "str" else rows)
                for name, camera in episode.cameras.items():
                    frames = episode.frames(name)
                    is_lossy = camera.kind == "color" and form == trajectory.FORMS[0]
                    writer.put_images(name, _jpegs(frames, samples.setdefault(name, [])) if is_lossy else frames)
                for name, value in beside.items():
                    (writer.put if _is_of_steps(value) else writer.put_constant)(name, value)
                for name, value in _instruction(episode).items():
                    if name not in episode.columns:
                        writer.put_constant(name, value)
                writer.subtasks = _subtasks(episode.extras.get(spec.Trajectory.SUBTASKS))
        except TrajectoryError as error:
            raise DataError(f"{episode.key}: {error}") from None
        if problems := trajectory_schema.schema_problems(path):
            raise DataError(f"{episode.key} would not match the standard's format: {replace(problems[0], file=None)}")
        worst = {name: min(values) for name, values in samples.items() if values}
        return WrittenEpisode({name: value for name, value in worst.items() if value != float("inf")})

    def finish(self, folder: Path, plan: WritePlan, pieces: list[WrittenEpisode]) -> Path:
        """Return the folder of the files."""
        del plan, pieces
        return folder / _SET


def _form(plan: WritePlan) -> str:
    """Return the encoding of camera images."""
    return trajectory.FORMS[0] if plan.options.images == "auto" else plan.options.images


def _instruction(episode: RecordedEpisode) -> dict[str, Any]:
    """Return the instructions under the standard's keys."""
    instructions = list(episode.instructions)
    if len(instructions) > 1:
        return {spec.Trajectory.INSTRUCTIONS: instructions}
    return {spec.Trajectory.INSTRUCTION: instructions[0]} if instructions else {}


def _jpegs(frames: Iterable[np.ndarray], psnr_db: list[float]) -> Iterator[bytes]:
    """Yield images as the standard's JPEGs; append the PSNR of every 16th to `psnr_db`."""
    for index, frame in enumerate(frames):
        data = image_codec.encode_jpeg(frame)
        if index % _SAMPLED == 0:
            psnr_db.append(image_files.psnr(frame, image_codec.decode(data)))
        yield data


def _beside_images(episode: RecordedEpisode) -> dict[str, Any]:
    """Return matrices and shapes of cameras, by path, where no column has them."""
    leaves = (*_MATRICES, spec.Camera.SHAPE)
    values_by_path = {
        name: value for name, value in episode.extras.items() if names.is_image(tuple(name.split("/")), *leaves)
    }
    for name, camera in episode.cameras.items():
        for (leaf, size), matrix in zip(_MATRICES.items(), (camera.intrinsics, camera.extrinsics), strict=True):
            if matrix is None or not name.startswith(f"{spec.Trajectory.VISION}/"):
                continue
            values = np.asarray(matrix, np.float64)
            if values.shape[-2:] == (3, 4) and size == 4:  # the last row is constant
                last = np.broadcast_to(np.array([[0.0, 0.0, 0.0, 1.0]]), (*values.shape[:-2], 1, 4))
                values = np.concatenate([values, last], axis=-2)
            if values.shape[-2:] == (size, size):
                values_by_path["/".join(names.stored_path((*name.split("/")[:-1], leaf)))] = values
    return {name: value for name, value in values_by_path.items() if name not in episode.columns}


def _is_of_steps(matrix: Any) -> bool:
    """Tell whether a camera matrix has one value per step."""
    try:
        return np.ndim(matrix) > 2
    except ValueError:  # ragged rows, which the writer rejects by name
        return False


def _subtasks(value: object) -> list[Any] | None:
    """Return the subtask annotations of an episode, which files store as JSON."""
    try:
        annotations = json_text.parse(value) if isinstance(value, str) else value
    except json_text.JsonError:
        return None
    return annotations if isinstance(annotations, list) else None
