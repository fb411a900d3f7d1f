"""The standard's own HDF5 form, as every other set is read: a view of `xpl.trajectory`."""

from __future__ import annotations

import contextlib
import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl import trajectory
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import Camera, Column

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

NAME: Final = "xpl"
_DEPTH: Final = "/depths"


def recognises(file: Any) -> bool:
    """Tell whether an open HDF5 file is one: a group of states, and one of actions."""
    return all(hasattr(file.get(name), "keys") for name in (sdk.Trajectory.STATE, sdk.Trajectory.ACTION))


def open_set(path: Path) -> StandardSet:
    """Return the trajectories below a folder, or in one file.

    Raises:
        DataError: there are none.
    """
    with _told():
        return StandardSet(trajectory.open_folder(path))


class StandardSet:
    """A folder of the standard's trajectories (`xpl_cli.data.sets.interface.Demonstrations`)."""

    def __init__(self, folder: trajectory.Folder) -> None:
        self._folder = folder

    @property
    def path(self) -> str:
        """The file or folder."""
        return self._folder.path

    @property
    def format(self) -> str:
        """The name of its format."""
        return NAME

    @functools.cached_property
    def rate_hz(self) -> float | None:
        """Steps per second, as the first episode says."""
        facts = self._folder.facts(0) or {}
        with _told():
            told = facts.get(sdk.Obs.FREQUENCY) or self._folder[0].frequency
        return None if told is None else float(told)

    @functools.cached_property
    def robot(self) -> str | None:
        """What the first episode calls its robot, if it does."""
        with _told():
            facts = self._folder.facts(0) or {"episode": self._folder[0].episode}
        told = (facts.get("episode") or {}).get("robot")
        return None if told is None else str(told)

    @property
    def extras(self) -> Mapping[str, Any]:
        """Nothing: every episode speaks for itself."""
        return {}

    def __len__(self) -> int:
        """How many episodes there are."""
        return len(self._folder)

    def __getitem__(self, index: int) -> StandardEpisode:
        """Return an episode, by its place."""
        return StandardEpisode(self._folder[index])


class StandardEpisode:
    """One trajectory (`xpl_cli.data.sets.interface.Episode`).

    Columns are datasets by their path, `state/arm_joint_states`. A camera is called as in the file; its depth is
    `<camera>/depths`.
    """

    def __init__(self, found: trajectory.Trajectory) -> None:
        self._found = found

    @property
    def key(self) -> str:
        """Its name in the set."""
        return self._found.key

    @functools.cached_property
    def length(self) -> int:
        """How many steps it has."""
        with _told():
            return len(self._found)

    @functools.cached_property
    def instructions(self) -> tuple[str, ...]:
        """What the robot was told."""
        with _told():
            return self._found.instructions

    @functools.cached_property
    def columns(self) -> Mapping[str, Column]:
        """The columns of numbers, by their path."""
        with _told():
            return {name: Column(shape, dtype) for name, (shape, dtype) in self._found.columns.items()}

    @functools.cached_property
    def cameras(self) -> Mapping[str, Camera]:
        """The cameras, by their names; reads the first image of those that are encoded."""
        with _told():
            colors = {name: self._color(name) for name in self._found.cameras}
            depths = {name + _DEPTH: self._depth(name) for name in self._found.depth_cameras}
        return {**colors, **depths}

    @functools.cached_property
    def extras(self) -> Mapping[str, Any]:
        """Facts of the episode, and its subtasks."""
        with _told():
            subtasks = self._found.subtasks
            return {**self._found.episode, **({} if subtasks is None else {sdk.Trajectory.SUBTASKS: subtasks})}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Return rows of a column (see `Episode.read`)."""
        if column not in self.columns:
            raise KeyError(f"{self.key} has no column {column!r}; it has {', '.join(self.columns)}")
        with _told():
            return self._found.rows(column, start, stop)

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[Any]]:
        """Yield images of a camera (see `Episode.frames`)."""
        if camera not in self.cameras:
            raise KeyError(f"{self.key} has no camera {camera!r}; it has {', '.join(self.cameras) or 'none'}")
        is_depth = self.cameras[camera].kind == "depth"
        name = camera.removesuffix(_DEPTH) if is_depth else camera
        look = self._found.depth if is_depth else self._found.image
        for step in range(*slice(start, stop).indices(self.length)):
            with _told():
                seen = look(name, step)
            yield seen

    def _color(self, name: str) -> Camera:
        height, width, encoding = self._found.form(name)
        return Camera(height, width, "color", encoding, *self._matrices(name))

    def _depth(self, name: str) -> Camera:
        height, width = self._found.datasets[sdk.Trajectory.VISION, name, sdk.Trajectory.DEPTHS].shape[1:3]
        return Camera(int(height), int(width), "depth", "raw", *self._matrices(name))

    def _matrices(self, name: str) -> Iterator[NDArray[Any] | None]:
        for leaf in (sdk.Trajectory.INTRINSIC_MATRIX, sdk.Trajectory.EXTRINSIC_MATRIX):
            path = (sdk.Trajectory.VISION, name, leaf)
            yield self._found.rows("/".join(path)) if path in self._found.datasets else None


@contextlib.contextmanager
def _told() -> Iterator[None]:
    try:
        yield
    except (trajectory.TrajectoryError, ImportError) as error:
        raise DataError(str(error)) from None
