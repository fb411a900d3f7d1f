"""Datasets converted by a mapping: other formats to the standard's names and conventions, and back."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.convert.assembly import assemble
from xpl.errors import ConversionError
from xpl.trajectory.names import stored_path
from xpl_cli.data.sets.delegating import DelegatingEpisode, DelegatingSet
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.contract import State
    from xpl_cli.data.conversion.mapping import DatasetMapping
    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

NAME = "xpl"
Rows = dict[str, np.ndarray]


class _MappedSet(DelegatingSet):
    """A dataset and the mapping that converts it."""

    def __init__(self, inner: Demonstrations, mapping: DatasetMapping, name: str | None = None) -> None:
        super().__init__(inner, name)
        self._mapping = mapping

    @property
    def rate_hz(self) -> float | None:
        """Steps per second: the dataset's, else the mapping's."""
        return self._inner.rate_hz or self._mapping.rate_hz


class StandardizedSet(_MappedSet):
    """A dataset in another format, converted to the standard by a mapping."""

    def __init__(self, inner: Demonstrations, mapping: DatasetMapping) -> None:
        super().__init__(inner, mapping, NAME)

    @property
    def robot(self) -> str | None:
        """The mapping's robot."""
        return self._mapping.embodiment.name

    def _wrap(self, episode: RecordedEpisode) -> StandardizedEpisode:
        return StandardizedEpisode(episode, self._mapping)


class NativeSet(_MappedSet):
    """A dataset in the standard's format, converted to another format's conventions by a mapping."""

    @property
    def robot(self) -> str | None:
        """The dataset's robot, else the mapping's."""
        return self._inner.robot or self._mapping.embodiment.name

    def _wrap(self, episode: RecordedEpisode) -> NativeEpisode:
        return NativeEpisode(episode, self._mapping)


class _MappedEpisode(DelegatingEpisode):
    """An episode converted by a mapping; common to both directions."""

    def __init__(self, inner: RecordedEpisode, mapping: DatasetMapping) -> None:
        super().__init__(inner)
        self._mapping = mapping

    @functools.cached_property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The converted columns, and every column that the mapping does not name."""
        converted = {name: ColumnInfo(rows.shape[1:], rows.dtype.name) for name, rows in self._rows.items()}
        unchanged = {name: column for name, column in self._inner.columns.items() if name not in self._used}
        return {**converted, **unchanged}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        if column in self._rows:
            return self._rows[column][start:stop]
        if column in self._used:
            raise KeyError(column)
        return self._inner.read(column, start, stop)

    @property
    def _rows(self) -> Rows:
        raise NotImplementedError

    @property
    def _used(self) -> frozenset[str]:
        raise NotImplementedError


class StandardizedEpisode(_MappedEpisode):
    """An episode in another format under the standard's names."""

    @functools.cached_property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras; those that the mapping does not name keep their names."""
        has = self._inner.cameras
        converted = {}
        for name, source in self._camera_sources.items():
            camera = has[source]
            height, width = camera.height, camera.width
            if self._mapping.images[source].view(np.zeros((height, width, 3), np.uint8)).shape[0] != height:
                height, width = width, height
            converted[name] = CameraInfo(
                height, width, spec.Camera.COLOR, camera.encoding, camera.intrinsics, camera.extrinsics
            )
        unchanged = {name: camera for name, camera in has.items() if name not in self._mapping.images}
        return {**converted, **unchanged}

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera, upright and RGB."""
        source = self._camera_sources.get(camera)
        if source is None:
            if camera in self._mapping.images:
                raise KeyError(camera)
            yield from self._inner.frames(camera, start, stop)
            return
        how, info = self._mapping.images[source], self.cameras[camera]
        sizes = {how.cameras[0]: (info.height, info.width)}
        for frame in self._inner.frames(source, start, stop):
            (image,) = how.decode(frame, sizes).values()
            yield image

    @functools.cached_property
    def _camera_sources(self) -> dict[str, str]:
        """The dataset's camera of each standard camera name; of two candidates the first that exists."""
        sources: dict[str, str] = {}
        for source, how in self._mapping.images.items():
            name = "/".join(stored_path((spec.Obs.VISION, how.cameras[0], spec.Camera.COLOR)))
            if source in self._inner.cameras and name not in sources:
                sources[name] = source
        return sources

    @functools.cached_property
    def _used(self) -> frozenset[str]:
        return frozenset((*self._mapping.states, *self._mapping.columns))

    @functools.cached_property
    def _rows(self) -> Rows:
        """The series of state and action, (T, width) float64."""
        where = f"{self._inner.key}, by the mapping {self._mapping.name}"
        try:
            state = self._state(where)
            action = self._action(state, where)
        except ConversionError as error:
            raise DataError(f"{where}: {error}") from None
        rows = {"/".join(stored_path((spec.Trajectory.STATE, key))): values for key, values in state.items()}
        rows |= {"/".join(stored_path((spec.Trajectory.ACTION, key))): values for key, values in action.items()}
        return rows

    def _state(self, where: str) -> Rows:
        parts, columns = [], {}
        for name, vector in self._mapping.states.items():
            for item, values in vector.split(vector.denormalize(self._column(name, where))):
                parts.append(item)
                columns[item.label] = values
        return assemble(parts, columns, _origins(self._mapping))

    def _action(self, state: Rows, where: str) -> Rows:
        """Return the commands; a delta action is relative to the state of its own step."""
        raw = np.concatenate([self._column(name, where) for name in self._mapping.columns], axis=1)
        shift = self._mapping.shift
        raw = np.concatenate([raw[shift:], np.repeat(raw[-1:], min(shift, len(raw)), axis=0)])
        output = self._mapping.action
        if not output.is_relative:
            return output.fields(raw, _origins(self._mapping))
        memory: dict[str, Any] = {}
        steps = [
            output.fields(raw[index : index + 1], {key: values[index] for key, values in state.items()}, memory)
            for index in range(len(raw))
        ]
        return {key: np.concatenate([step[key] for step in steps]) for key in steps[0]}

    def _column(self, name: str, where: str) -> NDArray[np.float64]:
        if name not in self._inner.columns:
            raise DataError(f"{where}: there is no column {name}; there are {', '.join(self._inner.columns)}")
        rows = self._inner.read(name)
        return rows.reshape(len(rows), -1).astype(np.float64)


class NativeEpisode(_MappedEpisode):
    """An episode in the standard's format under the names and conventions of a mapping."""

    @functools.cached_property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras; those that the mapping does not name keep their names."""
        has = self._inner.cameras
        converted = {}
        for name, source in self._camera_sources.items():
            camera = has[source]
            shape = self._mapping.images[name].view(np.zeros((camera.height, camera.width, 3), np.uint8)).shape
            converted[name] = CameraInfo(shape[0], shape[1], spec.Camera.COLOR, camera.encoding)
        unchanged = {name: camera for name, camera in has.items() if name not in self._camera_sources.values()}
        return {**converted, **unchanged}

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera, converted by the mapping."""
        if camera not in self._camera_sources:
            yield from self._inner.frames(camera, start, stop)
            return
        how = self._mapping.images[camera]
        for frame in self._inner.frames(self._camera_sources[camera], start, stop):
            yield how.view(frame)

    @functools.cached_property
    def _camera_sources(self) -> dict[str, str]:
        sources: dict[str, str] = {}
        for name, how in self._mapping.images.items():
            source = "/".join(stored_path((spec.Obs.VISION, how.cameras[0], spec.Camera.COLOR)))
            if source in self._inner.cameras and source not in sources.values():
                sources[name] = source
        return sources

    @functools.cached_property
    def _used(self) -> frozenset[str]:
        groups = (spec.Trajectory.STATE, spec.Trajectory.ACTION)
        return frozenset(name for group in groups for name in self._series(group).values())

    def _series(self, group: str) -> dict[str, str]:
        """The columns of a group that the mapping reads, by the standard's key."""
        vectors = self._mapping.states.values() if group == spec.Trajectory.STATE else [self._mapping.action.vector]
        keys = dict.fromkeys(item.key for vector in vectors for item in vector.parts if item.key)
        return {key: "/".join(stored_path((group, key))) for key in keys}

    @functools.cached_property
    def _rows(self) -> Rows:
        where = f"{self._inner.key}, by the mapping {self._mapping.name}"
        try:
            states = self._steps(spec.Trajectory.STATE, where)
            rows = {}
            for name, vector in self._mapping.states.items():
                pieces = [np.concatenate([item.read(state) for item in vector.parts]) for state in states]
                rows[name] = vector.normalize(np.stack(pieces))
            if not self._mapping.shift:
                rows |= self._commands(states, where)
        except (ConversionError, ValueError) as error:
            raise DataError(f"{where}: {error}") from None
        return rows

    def _commands(self, states: list[State], where: str) -> Rows:
        actions = self._steps(spec.Trajectory.ACTION, where)
        output = self._mapping.action
        memory: dict[str, Any] = {}
        if output.is_relative:
            rows = np.concatenate(
                [output.encode([one], state, memory) for one, state in zip(actions, states, strict=True)]
            )
        else:
            rows = output.encode(actions, states[0])
        if len(self._mapping.columns) == 1:
            return {self._mapping.columns[0]: rows}
        widths = np.cumsum([item.width for item in output.vector.parts])[:-1]
        return dict(zip(self._mapping.columns, np.split(rows, widths, axis=1), strict=True))

    def _steps(self, group: str, where: str) -> list[State]:
        series = self._series(group)
        lacking = [name for name in series.values() if name not in self._inner.columns]
        if lacking:
            raise DataError(f"{where}: the episode has no {', '.join(lacking)}")
        rows = {key: self._inner.read(name) for key, name in series.items()}
        return [{key: values[index] for key, values in rows.items()} for index in range(self.length)]


def _origins(mapping: DatasetMapping) -> dict[str, NDArray[np.float64]]:
    """Return a placeholder pose for each arm; unused where a dataset has both position and rotation."""
    return {
        arm.prefix + spec.State.EE_POSE: np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        for arm in mapping.embodiment.arms
    }
