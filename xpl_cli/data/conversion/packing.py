"""Packing of the standard's series into one state and one action vector, which most formats need, and unpacking.

The order is the standard's: for each arm its joints or pose, then its end effector; the left arm before the right one.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as spec
from xpl.trajectory.names import GROUND_TRUTH, is_ground_truth, observation_path
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.conversion.standard import NAME as STANDARD
from xpl_cli.data.formats.writing import CONVERTED
from xpl_cli.data.sets.delegating import DelegatingEpisode, DelegatingSet
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

NAME: Final = "packed series"
STATE, ACTION, ENVIRONMENT = "state", "action", "environment"
_PREFIXES: Final = tuple(dict.fromkeys(("left_", "right_", "")))
_MOTION: Final = (spec.State.ARM_JOINT_STATE, spec.State.EE_POSE)
Layout = dict[str, list[tuple[str, int]]]
"""The series of each vector, with their widths."""


def layout_of(episode: RecordedEpisode) -> Layout:
    """Return how an episode's series are packed; a group without series of an arm is not packed.

    Privileged information of a simulator is packed into a third vector: its float columns of at most one axis.
    """
    groups = {STATE: spec.Trajectory.STATE, ACTION: spec.Trajectory.ACTION}
    layout = {name: _series(episode.columns, group) for name, group in groups.items()}
    truth = {name: column for name, column in episode.columns.items() if is_ground_truth(tuple(name.split("/")))}
    layout[ENVIRONMENT] = [
        (name, column.shape[0] if column.shape else 1)
        for name, column in truth.items()
        if len(column.shape) <= 1 and column.dtype.startswith("float")
    ]
    return {name: parts for name, parts in layout.items() if parts}


class PackedSet(DelegatingSet):
    """A dataset in the standard's format whose series are packed.

    Args:
        inner: the dataset.

    Attributes:
        layout: the series of each vector.
        numbers: packed series that are scalars.
    """

    def __init__(self, inner: Demonstrations) -> None:
        super().__init__(inner, NAME)
        first = inner[0]
        self.layout = layout_of(first)
        parts = (part for parts in self.layout.values() for part, _ in parts)
        self.numbers = [part for part in parts if not first.columns[part].shape]

    def _wrap(self, episode: RecordedEpisode) -> RecordedEpisode:
        return _Packed(episode, self.layout)


class UnpackedSet(DelegatingSet):
    """A dataset converted from a packed one, with the standard's series and cameras restored.

    Args:
        inner: the dataset.
        names: the original names, by the dataset's names.
        numbers: columns that were scalars, by the dataset's names, or by their own where they were packed.
        layout: the series of each vector.
    """

    def __init__(
        self, inner: Demonstrations, names: Mapping[str, str], numbers: frozenset[str], layout: Layout
    ) -> None:
        super().__init__(inner, STANDARD)
        self._names, self._numbers, self._layout = names, numbers, layout

    def _wrap(self, episode: RecordedEpisode) -> RecordedEpisode:
        try:
            return _Unpacked(episode, self._names, self._numbers, self._layout)
        except _NotPackedError as error:
            message = f"{self.path}: {episode.key}: the dataset's {CONVERTED} record names {error}"
            raise DataError(message, code=ExitCode.FINDINGS) from None


class _NotPackedError(Exception):
    """An episode does not match the layout; the message says what is missing."""


class _Packed(DelegatingEpisode):
    def __init__(self, inner: RecordedEpisode, layout: Layout) -> None:
        super().__init__(inner)
        self._layout = layout

    @functools.cached_property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The vectors, and every column that is in none of them."""
        has = self._inner.columns
        vectors = {}
        for name, parts in self._layout.items():
            if any(part not in has for part, _ in parts):
                continue  # the writer reports that this episode lacks it
            dtype = np.result_type(*(has[part].dtype for part, _ in parts)).name
            entries = tuple(entry for part, width in parts for entry in _entries(part, width))
            vectors[name] = ColumnInfo((len(entries),), dtype, entries)
        used = {part for parts in self._layout.values() for part, _ in parts}
        return {**vectors, **{name: column for name, column in has.items() if name not in used}}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        if column not in self._layout:
            return self._inner.read(column, start, stop)
        rows = [self._inner.read(part, start, stop) for part, _ in self._layout[column]]
        return np.concatenate([part.reshape(len(part), -1) for part in rows], axis=1)


class _Unpacked(DelegatingEpisode):
    def __init__(
        self, inner: RecordedEpisode, names: Mapping[str, str], numbers: frozenset[str], layout: Layout
    ) -> None:
        super().__init__(inner)
        self._layout, self._numbers = layout, numbers
        self._old = {names.get(name, name): name for name in (*inner.columns, *inner.cameras)}
        self._parts: dict[str, tuple[str, int, int]] = {}
        for name, parts in layout.items():
            column, total = inner.columns.get(self._old.get(name, "")), sum(width for _, width in parts)
            if column is None or column.shape != (total,):
                has = "none" if column is None else column.shape
                raise _NotPackedError(f"a column {name} with rows of {total} numbers, the episode has {has}")
            begins = 0
            for part, width in parts:
                self._parts[part] = (self._old[name], begins, begins + width)
                begins += width
        old = [names.get(name, name) for name in (*inner.columns, *inner.cameras)]
        names_after = [
            *(name for name in old if name not in layout),
            *(part for parts in layout.values() for part, _ in parts),
        ]
        if len(set(old)) < len(old) or len(set(names_after)) < len(names_after):
            raise _NotPackedError("two columns or cameras of one name")

    @functools.cached_property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The series, and the other columns under their old names."""
        has = self._inner.columns
        unpacked = {
            part: ColumnInfo(() if part in self._numbers and last - first == 1 else (last - first,), has[name].dtype)
            for part, (name, first, last) in self._parts.items()
        }
        rest = {old: name for old, name in self._old.items() if name in has and old not in self._layout}
        unchanged = {
            old: ColumnInfo((), has[name].dtype) if self._is_number(name) else has[name] for old, name in rest.items()
        }
        return {**unpacked, **unchanged}

    def _is_number(self, name: str) -> bool:
        return name in self._numbers and math.prod(self._inner.columns[name].shape) == 1

    @property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras under their old names."""
        has = self._inner.cameras
        return {old: has[name] for old, name in self._old.items() if name in has}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        if column in self._parts:
            name, first, last = self._parts[column]
            rows = self._inner.read(name, start, stop)[:, first:last]
            return rows[:, 0] if not self.columns[column].shape else rows
        rows = self._inner.read(self._old[column], start, stop)
        return rows.reshape(len(rows)) if self._is_number(self._old[column]) else rows

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        return self._inner.frames(self._old[camera], start, stop)


def _series(columns: Mapping[str, ColumnInfo], group: str) -> list[tuple[str, int]]:
    series = []
    for prefix in _PREFIXES:
        by_key = {
            observation_path(tuple(name.split("/")))[-1]: name for name in columns if name.startswith(f"{group}/")
        }
        motion = next((prefix + key for key in _MOTION if prefix + key in by_key), None)
        for key in (motion, prefix + spec.State.EE_JOINT_STATE):
            name = by_key.get(key or "")
            if name is not None and len(columns[name].shape) == 1:
                series.append((name, columns[name].shape[0]))
    return series


def _entries(part: str, width: int) -> list[str]:
    path = tuple(part.split("/"))
    key = ".".join(path[len(GROUND_TRUTH) :]) if is_ground_truth(path) else observation_path(path)[-1]
    return [key] if width == 1 else [f"{key}_{index}" for index in range(width)]
