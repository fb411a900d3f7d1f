"""Writing of one episode to a file that appears complete or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl import image_codec as codec
from xpl.observation import ObservationError, is_encoded
from xpl.trajectory import index, names, storage
from xpl.trajectory.columns import ConstantColumn, EpisodeColumn, JsonTextList, NumericColumn, numbers
from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.ground_truth import GroundTruth
from xpl.trajectory.image_columns import DepthColumn, EncodedColumn, PixelColumn, decode_if_encoded, squeeze_depth

if TYPE_CHECKING:
    from types import TracebackType

    from xpl.contract import Action, Entry, Observation
    from xpl.trajectory.hdf5_types import HDF5File

JPEG, PADDED, PNG, RAW = "jpeg", "jpeg-padded", "png", "raw"
FORMS = (JPEG, PADDED, PNG, RAW)
"""Storage of colour images: JPEG, as (T,) of variable length or as (T, N) padded with NUL; PNG; or pixels.

JPEGs have the marker of `xpl.image_codec`.
"""

_NO_PART = (spec.Obs.DATA_FORMAT_VERSION, spec.Obs.ENV_IDX, spec.Obs.PRIVILEGED, spec.Trajectory.ACTION)
"""Keys of an observation that are not recorded as such: index in a batch, ground truth."""
_OWN = ((spec.Trajectory.DATA_FORMAT_VERSION,), (spec.Trajectory.ADDITIONAL_INFO, names.EPISODE))
"""Datasets that the writer itself adds."""
_STEADY = (spec.Camera.INTRINSIC_MATRIX, spec.Camera.EXTRINSICS_MATRIX, spec.Camera.SHAPE)
_SMALL: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


class Writer:
    """Writes one episode, step by step, in bounded memory.

    The file gets its name when the block ends without an exception; until then it is hidden.

        with Writer("demos/episode_0000000.hdf5", episode={"robot": "arx_x5"}) as writer:
            writer.add(obs, action)

    To write whole columns instead of steps, pass each with its path in the file:

            writer.put("state/ee_poses", rows)
            writer.put_images("vision/cam_head/colors", images)
            writer.put_constant("instruction", "lift the cube")

    Args:
        path: the file; a missing folder is created, an existing file replaced.
        images: one of `FORMS`. Images that are already encoded are stored unchanged, except for `raw`.
        quality: JPEG quality, 1..95.
        frequency: control rate, Hz, if observations do not contain it.
        episode: metadata of the episode, plain values; the attribute `episode` may be changed until the end.
        subtasks: annotations, plain values.
        indexed: append a line to the folder's index (`index.jsonl`).
        privileged: record the simulator's ground truth, too: arrays that every step has. The metadata of the episode
            lists them, and what was left out.

    Attributes:
        episode: metadata of the episode.
        subtasks: annotations; None for none.
        steps: number of control steps so far.

    Raises:
        ValueError: `images` is none of `FORMS`.
        TrajectoryError: the file cannot be written.
        ImportError: h5py is not installed.
    """

    def __init__(  # noqa: PLR0913 - by keyword, how one file differs from another
        self,
        path: str | os.PathLike[str],
        *,
        images: str = JPEG,
        quality: int = codec.DEFAULT_QUALITY,
        frequency: float | None = None,
        episode: Entry | None = None,
        subtasks: list[Any] | None = None,
        indexed: bool = True,
        privileged: bool = False,
    ) -> None:
        if images not in FORMS:
            raise ValueError(f"images must be one of {', '.join(FORMS)}, got {images!r}")
        self.path = Path(path)
        self.episode: dict[str, Any] = dict(episode or {})
        self.subtasks = subtasks
        self.steps = 0
        self._form, self._quality, self._frequency, self._indexed = images, quality, frequency, indexed
        self._columns: dict[names.DatasetPath, EpisodeColumn] = {}
        self._truth = GroundTruth() if privileged else None
        library = storage.hdf5()
        with self._trajectory_errors():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self.path.parent, prefix=f".{self.path.name}.", suffix=".part")
            os.close(handle)
            self._partial = Path(name)
            self._file: HDF5File = library.File(self._partial, "w")

    def __enter__(self) -> Writer:  # noqa: PYI034 - Python 3.9 has no Self
        """Return the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file, or discard it after an exception."""
        if kind is None:
            self.commit()
        else:
            self.discard()

    def add(self, obs: Observation, action: Action, **steps: object) -> None:
        """Add a control step.

        Args:
            obs: the observation before the action, as a policy gets it.
            action: the action, by the standard's keys.
            **steps: metadata of this step, numbers or text; `Trajectory.facts` returns them.

        Raises:
            TrajectoryError: the step has no state, or parts or shapes that differ from the first step; a value is
                neither numbers nor text; or the file cannot be written. The step is not added.
        """
        parts = dict(self._parts(obs, action, steps))
        if self._truth is not None:
            parts |= self._ground_truth_parts(self._truth, obs)
        if self._columns and parts.keys() != self._columns.keys():
            changes = (self._columns.keys() - parts.keys(), parts.keys() - self._columns.keys())
            lost, new = (", ".join(sorted(map("/".join, paths))) for paths in changes)
            differs = " and ".join(filter(None, [lost and f"lacks {lost}", new and f"adds {new}"]))
            raise TrajectoryError(f"{self.path}: step {self.steps} {differs}: all steps have what the first one has")
        with self._trajectory_errors():
            if not self._columns:
                self._columns = {path: self._column(path, value) for path, value in parts.items()}
            fitting = {path: column.convert(parts[path]) for path, column in self._columns.items()}
            for path, column in self._columns.items():
                column.add(fitting[path])
        self.steps += 1

    def put(self, name: str, rows: Iterable[object]) -> None:
        """Write a whole column.

        Args:
            name: path in the file, or in the observation.
            rows: one value per step, numbers or text.

        Raises:
            TrajectoryError: the number of steps differs from the earlier columns, or a value from the first one's type;
                the name is used already; or the file cannot be written.
        """

        def column(path: names.DatasetPath, first: Any) -> EpisodeColumn:
            if isinstance(first, str):
                return ConstantColumn(self._file, path, always=True)
            return NumericColumn(self._file, path, numbers(first, name), marked=not names.is_series(path))

        self._put(name, rows, column)

    def put_images(self, name: str, images: Iterable[object]) -> None:
        """Write all images of a camera.

        Args:
            name: see `put`.
            images: one per step: colour (H, W, 3) uint8 RGB or encoded, or depth (H, W).

        Raises:
            TrajectoryError: see `put`.
        """

        def column(path: names.DatasetPath, first: Any) -> EpisodeColumn:
            is_depth = not is_encoded(first) and squeeze_depth(first).ndim == 2
            return self._depth(path, first) if is_depth else self._images(path, first)

        self._put(name, images, column)

    def put_constant(self, name: str, value: object) -> None:
        """Write a constant: numbers, text, or a list of strings; name and errors as in `put`."""
        for path, entry in _leaves({name.rpartition("/")[2]: value}, tuple(name.split("/")[:-1])):
            with self._trajectory_errors():
                column = ConstantColumn(self._file, self._check_free(names.stored_path(path)))
                column.add(column.convert(entry))
                self._columns[names.stored_path(path)] = column

    def commit(self) -> None:
        """Complete the file; it is on disk when this returns.

        Raises:
            TrajectoryError: it has no step, or cannot be written; it is removed then.
        """
        try:
            with self._trajectory_errors():
                self._finish()
                self._partial.replace(self.path)
                if self._indexed:
                    index.append(self.path, self.facts)
        except BaseException:
            self.discard()
            raise

    def discard(self) -> None:
        """Remove the file."""
        with contextlib.suppress(Exception):
            self._file.close()
        with contextlib.suppress(OSError):
            self._partial.unlink()

    @property
    def facts(self) -> Entry:
        """Index entry of the episode."""
        return {"steps": self.steps, spec.Obs.FREQUENCY: self._frequency, "episode": storage.plain(self.episode)}

    def _finish(self) -> None:
        if not self.steps:
            raise TrajectoryError(f"{self.path}: an episode has at least one step")
        for column in self._columns.values():
            column.close()
        info = spec.Trajectory.ADDITIONAL_INFO
        if self._truth is not None:
            self.episode[spec.Obs.PRIVILEGED] = self._truth.facts
        metadata: dict[str, Any] = {
            spec.Trajectory.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
            f"{info}/{names.EPISODE}": json.dumps(storage.plain(self.episode)),
        }
        if self.subtasks is not None:
            metadata[spec.Trajectory.SUBTASKS] = json.dumps(storage.plain(self.subtasks))
        if self._frequency is not None and (info, spec.Obs.FREQUENCY) not in self._columns:
            metadata[f"{info}/{spec.Obs.FREQUENCY}"] = float(self._frequency)
        for name, value in metadata.items():
            kind = {"dtype": storage.hdf5().string_dtype()} if isinstance(value, str) else {}
            self._file.create_dataset(name, data=value, **kind)
        self._file.close()
        with self._partial.open("rb+") as stream:
            os.fsync(stream.fileno())
        self._partial.chmod(0o644)  # mkstemp creates private files

    def _parts(self, obs: Observation, action: Action, steps: Entry) -> Iterator[tuple[names.DatasetPath, Any]]:
        """Yield (path in the file, value) of a step."""
        series = {spec.Trajectory.STATE: obs.get(spec.Obs.STATE), spec.Trajectory.ACTION: action}
        for name, values in series.items():
            if not isinstance(values, Mapping) or not values:
                raise TrajectoryError(f"{self.path}: step {self.steps} has no {name}: a step has a state and an action")
        recorded = {key: value for key, value in obs.items() if key not in _NO_PART}
        info = spec.Trajectory.ADDITIONAL_INFO
        for part, value in _leaves({**recorded, spec.Trajectory.ACTION: action}, ()):
            if part[:2] in ((info, names.EPISODE), (info, names.STEPS)):
                raise TrajectoryError(f"{self.path}: {'/'.join(part)} is kept for facts of the episode and its steps")
            if part == (info, spec.Obs.FREQUENCY):
                self._frequency = float(value)
            yield names.stored_path(part), value
        for name, value in steps.items():
            if name == spec.Obs.PRIVILEGED:
                raise TrajectoryError(f"{self.path}: no fact of a step is called {name}: it stands for what is told so")
            yield (info, names.STEPS, name), value

    def _ground_truth_parts(self, truth: GroundTruth, obs: Observation) -> dict[names.DatasetPath, np.ndarray]:
        """Return the ground truth of a step by path; remove columns that no longer continue."""
        found = truth.parts(obs.get(spec.Obs.PRIVILEGED), self.steps)
        parts = {names.stored_path(path): array for path, array in found.items()}
        for path in [path for path in self._columns if names.is_ground_truth(path) and path not in parts]:
            del self._columns[path]
            with self._trajectory_errors():
                del self._file["/".join(path)]
        return parts

    def _put(self, name: str, values: Iterable[Any], make: Callable[[names.DatasetPath, Any], EpisodeColumn]) -> None:
        path = self._check_free(names.stored_path(tuple(name.split("/"))))
        column, count = None, 0
        with self._trajectory_errors():
            for value in values:
                if column is None:
                    column = self._columns[path] = make(path, value)
                column.add(column.convert(value))
                count += 1
        if count != (self.steps or count):
            raise TrajectoryError(f"{self.path}: {name} has {count} steps, and what was put before it {self.steps}")
        self.steps = count

    def _check_free(self, path: names.DatasetPath) -> names.DatasetPath:
        if path in self._columns or path in _OWN or not all(path):
            raise TrajectoryError(f"{self.path}: {'/'.join(path)!r} is there already, or cannot name a dataset")
        return path

    def _column(self, path: names.DatasetPath, value: Any) -> EpisodeColumn:
        """Return the column of a part, by its path and its first value."""
        if names.is_image(path, spec.Camera.COLOR):
            return self._images(path, value)
        if names.is_image(path, spec.Camera.DEPTH):
            return self._depth(path, value)
        is_of_steps = path[:2] == (spec.Trajectory.ADDITIONAL_INFO, names.STEPS)
        is_constant = path[0] == spec.Trajectory.ADDITIONAL_INFO and not is_of_steps
        if isinstance(value, str) or is_constant or names.is_image(path, *_STEADY):
            return ConstantColumn(self._file, path, always=is_of_steps)
        if names.is_ground_truth(path) and np.ndim(value) > 1:
            return NumericColumn(self._file, path, numbers(value, "/".join(path)), chunk=1, **_SMALL)
        return NumericColumn(self._file, path, numbers(value, "/".join(path)))

    def _depth(self, path: names.DatasetPath, value: Any) -> EpisodeColumn:
        return DepthColumn(self._file, path, squeeze_depth(value), chunk=1, **_SMALL)

    def _images(self, path: names.DatasetPath, value: Any) -> EpisodeColumn:
        if self._form == RAW:
            return PixelColumn(self._file, path, decode_if_encoded(value), chunk=1, **_SMALL)
        size = codec.size_of(value)[::-1] if is_encoded(value) else np.shape(value)[:2]
        encode = codec.encode_png if self._form == PNG else self._jpeg
        sizes = (int(size[0]), int(size[1]))
        return EncodedColumn(self._file, path, encode, sizes, padded=self._form == PADDED)

    def _jpeg(self, image: Any) -> bytes:
        return codec.encode_jpeg(image, self._quality)

    @contextlib.contextmanager
    def _trajectory_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise TrajectoryError(f"{self.path} cannot be written: {error.strerror or error}") from None
        except ObservationError as error:
            raise TrajectoryError(f"{self.path}: step {self.steps}: {error}") from None


def _leaves(value: Entry, path: names.DatasetPath) -> Iterator[tuple[names.DatasetPath, Any]]:
    """Yield (path, value) of nested maps; None is skipped."""
    for key, entry in value.items():
        name = str(key)
        if not name or "/" in name or name == ".":
            raise TrajectoryError(f"{'/'.join((*path, name))!r} cannot name a dataset")
        entry_path = (*path, name)
        if isinstance(entry, Mapping):
            yield from _leaves(entry, entry_path)
        elif path == (spec.Trajectory.VISION,):  # the image itself is the camera's entry
            yield (*entry_path, spec.Camera.COLOR), entry
        elif isinstance(entry, (list, tuple)) and entry and all(isinstance(one, str) for one in entry):
            yield entry_path, JsonTextList(json.dumps(list(entry)))
        elif entry is not None:
            yield entry_path, entry
