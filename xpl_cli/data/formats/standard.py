"""The standard's own HDF5 form, which RoboDojo's sets have, over `xpl.trajectory`, which reads and writes it.

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
from xpl import images, json_text, trajectory
from xpl.trajectory import TrajectoryError, names
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.formats import hdf5, image_codec, libraries
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
"""Every so many images are decoded again, to tell what they lost."""
_FACTS: Final = f"{spec.Trajectory.ADDITIONAL_INFO}/{names.EPISODE}"
_OWN: Final = (
    *(spec.Trajectory.INSTRUCTION, spec.Trajectory.INSTRUCTIONS, spec.Trajectory.SUBTASKS),
    *(spec.Trajectory.DATA_FORMAT_VERSION, f"{spec.Trajectory.ADDITIONAL_INFO}/{spec.Obs.FREQUENCY}", _FACTS),
)
"""What the standard's files have a place for."""
_BESIDE: Final = frozenset((spec.Trajectory.VISION, spec.Trajectory.ACTION))
"""Groups one of which lies beside the state."""
_MATRICES: Final = {spec.Camera.INTRINSIC_MATRIX: 3, spec.Camera.EXTRINSICS_MATRIX: 4}
"""What lies beside a camera's images, with rows and columns."""


def recognises(path: Path) -> bool:
    """Tell whether a set is one."""
    return hdf5.is_hdf5_set(path, lambda file: spec.Trajectory.STATE in file and not _BESIDE.isdisjoint(file))


def opened(path: Path) -> FolderSet:
    """Return the set; what an index beside the files says of them is not believed."""
    files = hdf5.OpenFileCache(trajectory.Trajectory)
    return FolderSet(path, NAME, hdf5.files(path), lambda file, key: _StandardFileEpisode((file, files), key))


class _StandardFileEpisode(OutlinedEpisode):
    """An episode. Its images are read from a file of their own, which is open as long as they are."""

    def __init__(self, file: tuple[Path, hdf5.OpenFileCache[Trajectory]], key: str) -> None:
        super().__init__(key)
        self._path, self._files = file

    @functools.cached_property
    def length(self) -> int:
        """How many steps it has."""
        with self._files.opened(self._path) as found:
            return len(found)

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        self.columns[column]  # whoever asks for another one gets KeyError
        with self._files.opened(self._path) as found:
            return found.rows(column, start, stop)

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images of a camera; JPEGs are RGB by the standard's rule, with its mark or exchanged without."""
        self.cameras[camera]
        with trajectory.Trajectory(str(self._path)) as found, hdf5.data_errors(found.path):
            yield from found.frames(camera, start, stop)

    def outline(self) -> Outline:
        """Return what the file says without rows and images."""
        with self._files.opened(self._path) as found:
            columns = {name: ColumnInfo(shape, dtype) for name, (shape, dtype) in found.columns.items()}
            cameras = {name: _camera(found, name, picture) for name, picture in found.pictures.items()}
            extras = found.rest
            told = tuple(one for one in found.instructions if one.strip())
            try:
                facts = found.episode
            except TrajectoryError:  # another file's, which means something else by it
                facts = {}
            else:
                extras.pop(_FACTS, None)
            extras |= facts
            length = len(found)
        return Outline(length, told or instructions_in(extras), columns, cameras, extras)


def _camera(found: Trajectory, name: str, picture: trajectory.Picture) -> CameraInfo:
    beside = tuple(name.split("/")[:-1])
    matrices = {
        names.shown(path)[-1]: found.rows("/".join(path))
        for path in found.datasets
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
    """The standard's own files, one for each episode: a mapping has to say which column is which part."""

    name = NAME
    names = NamingScheme("", "", "", f"{spec.Trajectory.VISION}/")

    def column_rejection(self, column: ColumnInfo) -> str | None:
        """Return why a column cannot be kept: HDF5 keeps all of them."""
        del column
        return None

    def camera_rejection(self, camera: CameraInfo) -> str | None:
        """Return why a camera cannot be kept: HDF5 keeps all of them."""
        del camera
        return None

    def check(self, plan: WritePlan) -> None:
        """Stop before anything is written."""
        if _form(plan) not in trajectory.FORMS:
            raise DataError(
                f"{self.name} keeps images in HDF5; --images takes {', '.join(trajectory.FORMS)} here",
                code=ExitCode.USAGE,
            )
        taken = {*plan.columns, *plan.cameras}
        for name in taken:
            groups = itertools.accumulate(name.split("/")[:-1], "{}/{}".format)
            if clash := next((group for group in groups if group in taken), None):
                raise DataError(f"HDF5 keeps {clash} and {name} not beside each other: one would be in the other")
        parts = (f"{spec.Trajectory.STATE}/", f"{spec.Trajectory.ACTION}/")
        if not any(name.startswith(parts) for name in plan.columns):
            raise DataError(
                f"the standard's form has state/ and action/, and {', '.join(plan.columns)} do not say what they are",
                hint="say it by --map MAPPING; libero, aloha and robotwin are ready",
            )

    def write_episode(self, folder: Path, plan: WritePlan, index: int, episode: RecordedEpisode) -> WrittenEpisode:
        """Write one episode's file, and its line in the index."""
        libraries.h5py()
        path, form = folder / _SET / f"episode_{index}.hdf5", _form(plan)
        for left in path.parent.glob(f".{path.name}.*"):  # by a run that was killed
            left.unlink()
        beside = _beside_images(episode)
        told = {key: value for key, value in episode.extras.items() if key not in (*_OWN, *beside)}
        told |= {"robot": plan.robot} if plan.robot is not None else {}
        told[CONVERTED] = plan.extras.get(CONVERTED, {})
        samples: dict[str, list[float]] = {}
        try:
            with trajectory.Writer(path, images=form, frequency=plan.rate_hz, episode=told) as writer:
                for name, column in episode.columns.items():
                    rows = episode.read(name)
                    writer.put(name, rows.tolist() if column.dtype == "str" else rows)
                for name, camera in episode.cameras.items():
                    frames = episode.frames(name)
                    is_lossy = camera.kind == "color" and form == trajectory.FORMS[0]
                    writer.put_images(name, _jpegs(frames, samples.setdefault(name, [])) if is_lossy else frames)
                for name, value in beside.items():
                    (writer.put if _is_of_steps(value) else writer.keep)(name, value)
                for name, value in _instruction(episode).items():
                    if name not in episode.columns:
                        writer.keep(name, value)
                writer.subtasks = _subtasks(episode.extras.get(spec.Trajectory.SUBTASKS))
        except TrajectoryError as error:
            raise DataError(f"{episode.key}: {error}") from None
        if problems := trajectory_schema.schema_problems(path):
            raise DataError(f"{episode.key} would not be of the standard's form: {replace(problems[0], file=None)}")
        worst = {name: min(values) for name, values in samples.items() if values}
        return WrittenEpisode({name: value for name, value in worst.items() if value != float("inf")})

    def finish(self, folder: Path, plan: WritePlan, pieces: list[WrittenEpisode]) -> Path:
        """Return the folder: the files are the set."""
        del plan, pieces
        return folder / _SET


def _form(plan: WritePlan) -> str:
    """Return how cameras are kept."""
    return trajectory.FORMS[0] if plan.options.images == "auto" else plan.options.images


def _instruction(episode: RecordedEpisode) -> dict[str, Any]:
    """Return what the robot was told, under the standard's names."""
    told = list(episode.instructions)
    if len(told) > 1:
        return {spec.Trajectory.INSTRUCTIONS: told}
    return {spec.Trajectory.INSTRUCTION: told[0]} if told else {}


def _jpegs(frames: Iterable[np.ndarray], psnr_db: list[float]) -> Iterator[bytes]:
    """Yield images as the standard's JPEGs; note how near those of a sample are."""
    for index, frame in enumerate(frames):
        data = images.encode_jpeg(frame)
        if index % _SAMPLED == 0:
            psnr_db.append(image_codec.psnr(frame, images.decode(data)))
        yield data


def _beside_images(episode: RecordedEpisode) -> dict[str, Any]:
    """Return what the standard's files have of a camera beside its images, by place, where no column has it."""
    leaves = (*_MATRICES, spec.Camera.SHAPE)
    found = {name: value for name, value in episode.extras.items() if names.is_image(tuple(name.split("/")), *leaves)}
    for name, camera in episode.cameras.items():
        for (leaf, size), matrix in zip(_MATRICES.items(), (camera.intrinsics, camera.extrinsics), strict=True):
            if matrix is None or not name.startswith(f"{spec.Trajectory.VISION}/"):
                continue
            values = np.asarray(matrix, np.float64)
            if values.shape[-2:] == (3, 4) and size == 4:  # its last row says nothing
                last = np.broadcast_to(np.array([[0.0, 0.0, 0.0, 1.0]]), (*values.shape[:-2], 1, 4))
                values = np.concatenate([values, last], axis=-2)
            if values.shape[-2:] == (size, size):
                found["/".join(names.stored((*name.split("/")[:-1], leaf)))] = values
    return {name: value for name, value in found.items() if name not in episode.columns}


def _is_of_steps(matrix: Any) -> bool:
    """Tell whether what lies beside images is a matrix for each step."""
    try:
        return np.ndim(matrix) > 2
    except ValueError:  # rows of several lengths, which whoever keeps them refuses by their name
        return False


def _subtasks(value: object) -> list[Any] | None:
    """Return annotations of an episode, which a file has as JSON."""
    try:
        told = json_text.parse(value) if isinstance(value, str) else value
    except json_text.JsonError:
        return None
    return told if isinstance(told, list) else None
