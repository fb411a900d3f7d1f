"""Writes one episode as a file that appears whole, under its name, or not at all."""

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
from xpl import images as codec
from xpl.observation import ObservationError, is_encoded
from xpl.trajectory import index, names, storage
from xpl.trajectory.columns import Column, Listed, Rows, Steady, numbers
from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.image_columns import Depth, Encoded, Pixels, decoded, flat
from xpl.trajectory.truth import Truth

if TYPE_CHECKING:
    from types import TracebackType

    from xpl.contract import Action, Entry, Observation
    from xpl.trajectory.nodes import File

JPEG, PADDED, PNG, RAW = "jpeg", "jpeg-padded", "png", "raw"
FORMS = (JPEG, PADDED, PNG, RAW)
"""How colour images lie in a file: JPEG, as (T,) of variable length or as (T, N) padded with NUL; PNG; or pixels.

Every JPEG is a standard one, stamped with the marker of `xpl.images`.
"""

_NO_PART = (spec.Obs.DATA_FORMAT_VERSION, spec.Obs.ENV_IDX, spec.Obs.PRIVILEGED, spec.Trajectory.ACTION)
"""What an observation may hold beside what is kept of each: its place in a batch, and what no robot sees."""
_OWN = ((spec.Trajectory.DATA_FORMAT_VERSION,), (spec.Trajectory.ADDITIONAL_INFO, names.EPISODE))
"""What the writer itself says in each file."""
_STEADY = (spec.Camera.INTRINSIC_MATRIX, spec.Camera.EXTRINSICS_MATRIX, spec.Camera.SHAPE)
_SMALL: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


class Writer:
    """Writes one episode, step by step, in bounded memory.

    The file appears under its name when the block ends without an exception; until then it is a hidden one beside it.

        with Writer("demos/episode_0000000.hdf5", episode={"robot": "arx_x5"}) as writer:
            writer.add(obs, action)

    Who has an episode part by part instead of step by step puts each whole, by its path in the file:

            writer.put("state/ee_poses", rows)
            writer.put_images("vision/cam_head/colors", images)
            writer.keep("instruction", "lift the cube")

    Args:
        path: the file; its folder is made where it is missing, and a file that is there is replaced.
        images: one of `FORMS`. Images that come encoded are kept as they are, but for `raw`.
        quality: of JPEGs, 1 to 95.
        frequency: control steps per second, where observations do not tell.
        episode: facts of the episode, plain values; may be changed until the end, as `episode`.
        subtasks: annotations, plain values.
        indexed: whether the folder's index (`index.jsonl`) gets a line.
        privileged: whether what a simulator tells privileged policies is kept, too: its arrays of numbers that each
            step has. The facts of the episode say which these are, and what was left out.

    Attributes:
        episode: facts of the episode.
        subtasks: annotations; None for none.
        steps: control steps so far.

    Raises:
        ValueError: there is no such form of images.
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
        self._columns: dict[names.Place, Column] = {}
        self._truth = Truth() if privileged else None
        library = storage.hdf5()
        with self._told():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self.path.parent, prefix=f".{self.path.name}.", suffix=".part")
            os.close(handle)
            self._partial = Path(name)
            self._file: File = library.File(self._partial, "w")

    def __enter__(self) -> Writer:  # noqa: PYI034 - Python 3.9 has no Self
        """Return the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Put the file in place, unless something was raised."""
        if kind is None:
            self.commit()
        else:
            self.discard()

    def add(self, obs: Observation, action: Action, **steps: object) -> None:
        """Add a control step.

        Args:
            obs: the observation before it, of the standard, as a policy gets it.
            action: what was commanded then.
            **steps: further facts of this step, numbers or texts; read back as `Trajectory.facts`.

        Raises:
            TrajectoryError: it has no state, other parts than the first step, or one of another shape; a value is
                neither numbers nor text; or the file cannot be written. Nothing of the step is added then.
        """
        parts = dict(self._parts(obs, action, steps))
        if self._truth is not None:
            parts |= self._told_truth(self._truth, obs)
        if self._columns and parts.keys() != self._columns.keys():
            changes = (self._columns.keys() - parts.keys(), parts.keys() - self._columns.keys())
            lost, new = (", ".join(sorted(map("/".join, paths))) for paths in changes)
            differs = " and ".join(filter(None, [lost and f"lacks {lost}", new and f"adds {new}"]))
            raise TrajectoryError(f"{self.path}: step {self.steps} {differs}: all steps have what the first one has")
        with self._told():
            if not self._columns:
                self._columns = {path: self._column(path, value) for path, value in parts.items()}
            fitting = {path: column.fitting(parts[path]) for path, column in self._columns.items()}
            for path, column in self._columns.items():
                column.add(fitting[path])
        self.steps += 1

    def put(self, name: str, rows: Iterable[object]) -> None:
        """Put a whole column.

        Args:
            name: its path in the file; names of an observation are taken as well.
            rows: one value for each step, numbers or texts.

        Raises:
            TrajectoryError: there are more or fewer than of what was put before, or one is of another kind than the
                first; the name is taken; or the file cannot be written.
        """

        def column(path: names.Place, first: Any) -> Column:
            if isinstance(first, str):
                return Steady(self._file, path, always=True)
            return Rows(self._file, path, numbers(first, name), marked=not names.is_series(path))

        self._put(name, rows, column)

    def put_images(self, name: str, images: Iterable[object]) -> None:
        """Put all images of a camera.

        Args:
            name: as of `put`.
            images: one for each step: colour (H, W, 3) uint8 RGB or encoded, or depth (H, W).

        Raises:
            TrajectoryError: as `put`.
        """

        def column(path: names.Place, first: Any) -> Column:
            is_depth = not is_encoded(first) and flat(first).ndim == 2
            return self._depth(path, first) if is_depth else self._images(path, first)

        self._put(name, images, column)

    def keep(self, name: str, value: object) -> None:
        """Keep what holds for all steps: numbers, a text, or a list of texts; name and errors as of `put`."""
        for path, told in _leaves({name.rpartition("/")[2]: value}, tuple(name.split("/")[:-1])):
            with self._told():
                column = Steady(self._file, self._free(names.stored(path)))
                column.add(column.fitting(told))
                self._columns[names.stored(path)] = column

    def commit(self) -> None:
        """Put the file in place; it is on the disk when this returns.

        Raises:
            TrajectoryError: it has no step, or cannot be written; nothing is left of it then.
        """
        try:
            with self._told():
                self._finish()
                self._partial.replace(self.path)
                if self._indexed:
                    index.note(self.path, self.facts)
        except BaseException:
            self.discard()
            raise

    def discard(self) -> None:
        """Drop the file."""
        with contextlib.suppress(Exception):
            self._file.close()
        with contextlib.suppress(OSError):
            self._partial.unlink()

    @property
    def facts(self) -> Entry:
        """What the folder's index says of the episode."""
        return {"steps": self.steps, spec.Obs.FREQUENCY: self._frequency, "episode": storage.plain(self.episode)}

    def _finish(self) -> None:
        if not self.steps:
            raise TrajectoryError(f"{self.path}: an episode has at least one step")
        for column in self._columns.values():
            column.close()
        info = spec.Trajectory.ADDITIONAL_INFO
        if self._truth is not None:
            self.episode[spec.Obs.PRIVILEGED] = self._truth.facts
        told: dict[str, Any] = {
            spec.Trajectory.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
            f"{info}/{names.EPISODE}": json.dumps(storage.plain(self.episode)),
        }
        if self.subtasks is not None:
            told[spec.Trajectory.SUBTASKS] = json.dumps(storage.plain(self.subtasks))
        if self._frequency is not None and (info, spec.Obs.FREQUENCY) not in self._columns:
            told[f"{info}/{spec.Obs.FREQUENCY}"] = float(self._frequency)
        for name, value in told.items():
            kind = {"dtype": storage.hdf5().string_dtype()} if isinstance(value, str) else {}
            self._file.create_dataset(name, data=value, **kind)
        self._file.close()
        with self._partial.open("rb+") as stream:
            os.fsync(stream.fileno())
        self._partial.chmod(0o644)  # mkstemp makes files private

    def _parts(self, obs: Observation, action: Action, steps: Entry) -> Iterator[tuple[names.Place, Any]]:
        """Yield what is stored of a step, under the names of the file."""
        series = {spec.Trajectory.STATE: obs.get(spec.Obs.STATE), spec.Trajectory.ACTION: action}
        for name, told in series.items():
            if not isinstance(told, Mapping) or not told:
                raise TrajectoryError(f"{self.path}: step {self.steps} has no {name}: a step has a state and an action")
        kept = {key: value for key, value in obs.items() if key not in _NO_PART}
        info = spec.Trajectory.ADDITIONAL_INFO
        for part, value in _leaves({**kept, spec.Trajectory.ACTION: action}, ()):
            if part[:2] in ((info, names.EPISODE), (info, names.STEPS)):
                raise TrajectoryError(f"{self.path}: {'/'.join(part)} is kept for facts of the episode and its steps")
            if part == (info, spec.Obs.FREQUENCY):
                self._frequency = float(value)
            yield names.stored(part), value
        for name, value in steps.items():
            if name == spec.Obs.PRIVILEGED:
                raise TrajectoryError(f"{self.path}: no fact of a step is called {name}: it stands for what is told so")
            yield (info, names.STEPS, name), value

    def _told_truth(self, truth: Truth, obs: Observation) -> dict[names.Place, np.ndarray]:
        """Return what is kept of what privileged policies are told; what does not go on is taken out again."""
        found = truth.parts(obs.get(spec.Obs.PRIVILEGED), self.steps)
        parts = {names.stored(path): array for path, array in found.items()}
        for path in [path for path in self._columns if names.is_truth(path) and path not in parts]:
            del self._columns[path]
            with self._told():
                del self._file["/".join(path)]
        return parts

    def _put(self, name: str, values: Iterable[Any], make: Callable[[names.Place, Any], Column]) -> None:
        path = self._free(names.stored(tuple(name.split("/"))))
        column, count = None, 0
        with self._told():
            for value in values:
                if column is None:
                    column = self._columns[path] = make(path, value)
                column.add(column.fitting(value))
                count += 1
        if count != (self.steps or count):
            raise TrajectoryError(f"{self.path}: {name} has {count} steps, and what was put before it {self.steps}")
        self.steps = count

    def _free(self, path: names.Place) -> names.Place:
        if path in self._columns or path in _OWN or not all(path):
            raise TrajectoryError(f"{self.path}: {'/'.join(path)!r} is there already, or cannot name a dataset")
        return path

    def _column(self, path: names.Place, value: Any) -> Column:
        """Return what takes the values of a part, by where it lies and its first one."""
        if names.is_image(path, spec.Camera.COLOR):
            return self._images(path, value)
        if names.is_image(path, spec.Camera.DEPTH):
            return self._depth(path, value)
        is_of_steps = path[:2] == (spec.Trajectory.ADDITIONAL_INFO, names.STEPS)
        is_constant = path[0] == spec.Trajectory.ADDITIONAL_INFO and not is_of_steps
        if isinstance(value, str) or is_constant or names.is_image(path, *_STEADY):
            return Steady(self._file, path, always=is_of_steps)
        if names.is_truth(path) and np.ndim(value) > 1:
            return Rows(self._file, path, numbers(value, "/".join(path)), chunk=1, **_SMALL)
        return Rows(self._file, path, numbers(value, "/".join(path)))

    def _depth(self, path: names.Place, value: Any) -> Column:
        return Depth(self._file, path, flat(value), chunk=1, **_SMALL)

    def _images(self, path: names.Place, value: Any) -> Column:
        if self._form == RAW:
            return Pixels(self._file, path, decoded(value), chunk=1, **_SMALL)
        size = codec.size_of(value)[::-1] if is_encoded(value) else np.shape(value)[:2]
        encode = codec.encode_png if self._form == PNG else self._jpeg
        sizes = (int(size[0]), int(size[1]))
        return Encoded(self._file, path, encode, sizes, padded=self._form == PADDED)

    def _jpeg(self, image: Any) -> bytes:
        return codec.encode_jpeg(image, self._quality)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise TrajectoryError(f"{self.path} cannot be written: {error.strerror or error}") from None
        except ObservationError as error:
            raise TrajectoryError(f"{self.path}: step {self.steps}: {error}") from None


def _leaves(value: Entry, path: names.Place) -> Iterator[tuple[names.Place, Any]]:
    """Yield the values of nested maps that are something."""
    for key, entry in value.items():
        name = str(key)
        if not name or "/" in name or name == ".":
            raise TrajectoryError(f"{'/'.join((*path, name))!r} cannot name a dataset")
        place = (*path, name)
        if isinstance(entry, Mapping):
            yield from _leaves(entry, place)
        elif path == (spec.Trajectory.VISION,):  # the image right below the camera's name, as some have it
            yield (*place, spec.Camera.COLOR), entry
        elif isinstance(entry, (list, tuple)) and entry and all(isinstance(one, str) for one in entry):
            yield place, Listed(json.dumps(list(entry)))
        elif entry is not None:
            yield place, entry
