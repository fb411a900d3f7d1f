"""Reads one episode: observations and actions as a policy has them, and columns and images as a set has them."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.trajectory import names, pictures, storage
from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.file import INFO, NO_VALUE, EpisodeFile

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from xpl.trajectory.nodes import Dataset
    from xpl.trajectory.pictures import Picture


def read(path: str | os.PathLike[str]) -> Trajectory:
    """Return the trajectory in a file.

    Raises:
        TrajectoryError: there is no such file, or it is no trajectory.
        ImportError: h5py is not installed.
    """
    found = Trajectory(os.fspath(path))
    found.datasets  # noqa: B018 - opens it, so that a wrong path is told here
    return found


class Trajectory(EpisodeFile):
    """One recorded episode. It is opened when something of it is asked for, and closed with `close` or when forgotten.

    `len(trajectory)` is the number of control steps. Iteration yields observation and action of each.

    Args:
        path: the file.
        key: its name in a set; its file's name without the ending by default.
        steps: how many steps it has, where that is known.

    Attributes:
        path: the file.
        key: its name in a set.
    """

    def __iter__(self) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
        """Yield observation and action of each step."""
        return ((self.observation(step), self.action(step)) for step in range(len(self)))

    @property
    def frequency(self) -> float | None:
        """Control steps per second, if the file says so."""
        found = self.datasets.get((INFO, spec.Obs.FREQUENCY))
        return None if found is None else float(np.ravel(storage.rows(found))[0])

    @property
    def instructions(self) -> tuple[str, ...]:
        """What the robot was told: one wording, or several; none where the file has none."""
        several = self.datasets.get((spec.Trajectory.INSTRUCTIONS,))
        if several is not None:
            return tuple(storage.wordings(several))
        one = self.datasets.get((spec.Trajectory.INSTRUCTION,))
        told = None if one is None else storage.text(one)
        return () if told is None else tuple(dict.fromkeys([told] if isinstance(told, str) else told))

    @property
    def subtasks(self) -> Any:
        """Annotations of parts of the episode, plain data; None where there are none."""
        found = self.datasets.get((spec.Trajectory.SUBTASKS,))
        return None if found is None else storage.document(found)

    @property
    def episode(self) -> dict[str, Any]:
        """Facts of the episode, as `Writer` was told; empty where the file has none."""
        found = self.datasets.get((INFO, names.EPISODE))
        if found is None:
            return {}
        told = storage.document(found)
        if not isinstance(told, dict):
            raise TrajectoryError(f"{storage.where(found)}: expected a map, got {type(told).__name__}")
        return told

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras that have colour images."""
        return tuple(path[1] for path in self.datasets if names.is_image(path, spec.Camera.COLOR))

    @property
    def depth_cameras(self) -> tuple[str, ...]:
        """The cameras that have depth."""
        return tuple(path[1] for path in self.datasets if names.is_image(path, spec.Camera.DEPTH))

    @property
    def pictures(self) -> dict[str, Picture]:
        """What datasets are images, by path: colour and depth of cameras, and whatever else has an image a step.

        Raises:
            TrajectoryError: a camera's images are none, or larger than is read.
        """
        if self._seen is None:
            rows = ((path, data) for path, data in self.datasets.items() if data.shape[:1] == (len(self),))
            seen = (("/".join(path), pictures.found(path, dataset)) for path, dataset in rows)
            self._seen = {name: picture for name, picture in seen if picture is not None}
        return self._seen

    @property
    def columns(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """The datasets of numbers and texts with a row for each step: shape of a row and dtype by path, text as str."""
        found = {}
        for path, dataset in self.datasets.items():
            name, kind = "/".join(path), self._read_as(path, dataset)[0]
            if kind in ("row", "text") and name not in self.pictures:
                found[name] = (tuple(dataset.shape[1:]), dataset.dtype.name if kind == "row" else "str")
        return found

    @property
    def rest(self) -> dict[str, Any]:
        """What is neither column nor image, plain data by name: attributes of the file, and what holds for all steps.

        JSON is left as text, and what is too large to be a fact left out.
        """
        known = {*self.columns, *self.pictures}
        found = {name: storage.plain(value) for name, value in self.file.attrs.items()}
        for path, dataset in self.datasets.items():
            name = "/".join(path)
            if name not in known and dataset.size <= storage.MOST_FACT:
                found[name] = storage.plain(dataset[()])
        return found

    def form(self, camera: str) -> tuple[int, int, str]:
        """Return height and width of a camera's colour images, and how they lie in the file, as `Picture` says it.

        Raises:
            KeyError: there is no such camera.
            TrajectoryError: the first image cannot be read.
        """
        _, dataset = self._camera(camera, spec.Camera.COLOR)
        picture = self.pictures.get(dataset.name.lstrip("/"))
        if picture is None:
            raise TrajectoryError(f"{storage.where(dataset)}: expected images, got {dataset.shape} {dataset.dtype}")
        return picture.height, picture.width, picture.encoding

    def observation(self, step: int, cameras: Collection[str] | None = None) -> dict[str, Any]:
        """Return the observation of a step as a policy gets it: colour images decoded, RGB.

        Of an episode that was recorded with it, `privileged` is there, too: show it to none that may not know.

        Args:
            step: from 0.
            cameras: those that are read; None for all.

        Raises:
            IndexError: there is no such step.
            TrajectoryError: the file cannot be read there; it says which dataset.
        """

        def is_wanted(path: names.Place) -> bool:
            if path[0] == spec.Trajectory.VISION and cameras is not None:
                return path[1] in cameras
            return path[0] != spec.Trajectory.ACTION

        return self._tree(self._checked(step), is_wanted)

    def action(self, step: int) -> dict[str, Any]:
        """Return what was commanded at a step, after its observation; raises as `observation`."""
        tree = self._tree(self._checked(step), lambda path: path[0] == spec.Trajectory.ACTION)
        action: dict[str, Any] = tree.get(spec.Trajectory.ACTION, {})
        return action

    def facts(self, step: int) -> dict[str, Any]:
        """Return the further facts of a step, as `Writer.add` was told; raises as `observation`."""
        place, found = self._checked(step), {}
        for path, dataset in self.datasets.items():
            if path[:2] == (INFO, names.STEPS) and not names.is_truth(path):
                found["/".join(path[2:])] = self._value(path, dataset, place)
        return found

    def image(self, camera: str, step: int) -> np.ndarray:
        """Return a camera's colour image, (H, W, 3) uint8 RGB.

        Raises:
            KeyError: there is no such camera.
            IndexError: there is no such step.
            TrajectoryError: the image cannot be decoded; it says which.
        """
        path, dataset = self._camera(camera, spec.Camera.COLOR)
        image: np.ndarray = self._value(path, dataset, self._checked(step))
        return image

    def depth(self, camera: str, step: int) -> np.ndarray:
        """Return a camera's depth, (H, W) float, metres; raises as `image`."""
        path, dataset = self._camera(camera, spec.Camera.DEPTH)
        depth: np.ndarray = self._value(path, dataset, self._checked(step))
        return depth

    def frames(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images of one of `pictures`, decoded one after the other; arguments as of `rows`.

        Raises:
            KeyError: there are no such images.
            TrajectoryError: one cannot be decoded; it says which.
        """
        picture = self.pictures.get(name)
        if picture is None:
            raise KeyError(f"{self.path} has no images {name}; it has {', '.join(self.pictures) or 'none at all'}")
        dataset = self.datasets[tuple(name.split("/"))]
        steps = range(*slice(start, stop).indices(len(self)))
        if picture.encoding != "raw":
            yield from (pictures.unpacked(dataset, *one) for one in pictures.series(dataset, steps))
            return
        for step in steps:
            image = storage.rows(dataset, step)
            yield image[..., 0] if picture.kind == spec.Camera.DEPTH and image.ndim == 3 else image

    def _camera(self, camera: str, leaf: str) -> tuple[names.Place, Dataset]:
        for path, dataset in self.datasets.items():
            if names.is_image(path, leaf) and path[1] == camera:
                return path, dataset
        known = self.cameras if leaf == spec.Camera.COLOR else self.depth_cameras
        raise KeyError(f"{self.path} has no {leaf} of {camera!r}; it has that of {', '.join(known) or 'no camera'}")

    def _tree(self, step: int, wanted: Callable[[names.Place], bool]) -> dict[str, Any]:
        tree: dict[str, Any] = {}
        for path, dataset in self.datasets.items():
            is_fact = path[:2] in ((INFO, names.EPISODE), (INFO, names.STEPS)) or path == (spec.Trajectory.SUBTASKS,)
            if (is_fact and not names.is_truth(path)) or not wanted(path):
                continue
            value = self._value(path, dataset, step)
            if value is not NO_VALUE:
                *groups, leaf = names.shown(path)
                inner = tree
                for name in groups:
                    inner = inner.setdefault(name, {})
                inner[leaf] = value
        several = tree.get(spec.Obs.INSTRUCTIONS)
        if several and spec.Obs.INSTRUCTION not in tree:
            tree[spec.Obs.INSTRUCTION] = several[0]
        return tree
