"""Reading of one episode: observations and actions for a policy; columns and images for a data set."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.trajectory import image_datasets, names, storage
from xpl.trajectory.errors import TrajectoryError
from xpl.trajectory.file import INFO, NO_VALUE, EpisodeFile

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from xpl.trajectory.hdf5_types import HDF5Dataset
    from xpl.trajectory.image_datasets import ImageSeries


def read(path: str | os.PathLike[str]) -> Trajectory:
    """Return the trajectory in a file.

    Raises:
        TrajectoryError: there is no such file, or it is no trajectory.
        ImportError: h5py is not installed.
    """
    trajectory = Trajectory(os.fspath(path))
    trajectory.datasets  # noqa: B018 - opens the file, so that a wrong path raises here
    return trajectory


class Trajectory(EpisodeFile):
    """One recorded episode. The file is opened on first access, and closed by `close` or with the object.

    `len(trajectory)` is the number of control steps. Iteration yields observation and action of each.

    Args:
        path: the file.
        key: its name in a data set; by default the file name without suffix.
        steps: number of steps, if known.

    Attributes:
        path: the file.
        key: its name in a data set.
    """

    def __iter__(self) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
        """Yield observation and action of each step."""
        return ((self.observation(step), self.action(step)) for step in range(len(self)))

    @property
    def frequency(self) -> float | None:
        """Control rate, Hz; None if the file does not have it."""
        dataset = self.datasets.get((INFO, spec.Obs.FREQUENCY))
        return None if dataset is None else float(np.ravel(storage.rows(dataset))[0])

    @property
    def instructions(self) -> tuple[str, ...]:
        """Instructions: one or several wordings; empty if the file has none."""
        several = self.datasets.get((spec.Trajectory.INSTRUCTIONS,))
        if several is not None:
            return tuple(storage.instructions(several))
        one = self.datasets.get((spec.Trajectory.INSTRUCTION,))
        text = None if one is None else storage.text(one)
        return () if text is None else tuple(dict.fromkeys([text] if isinstance(text, str) else text))

    @property
    def subtasks(self) -> Any:
        """Annotations of parts of the episode, plain data; None if there are none."""
        dataset = self.datasets.get((spec.Trajectory.SUBTASKS,))
        return None if dataset is None else storage.document(dataset)

    @property
    def episode(self) -> dict[str, Any]:
        """Metadata of the episode, as passed to `Writer`; empty if the file has none."""
        dataset = self.datasets.get((INFO, names.EPISODE))
        if dataset is None:
            return {}
        facts = storage.document(dataset)
        if not isinstance(facts, dict):
            raise TrajectoryError(f"{storage.describe(dataset)}: expected a map, got {type(facts).__name__}")
        return facts

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras with colour images."""
        return tuple(path[1] for path in self.datasets if names.is_image(path, spec.Camera.COLOR))

    @property
    def depth_cameras(self) -> tuple[str, ...]:
        """Cameras with depth images."""
        return tuple(path[1] for path in self.datasets if names.is_image(path, spec.Camera.DEPTH))

    @property
    def pictures(self) -> dict[str, ImageSeries]:
        """Image datasets by path: colour and depth of cameras, and any other dataset with one image per step.

        Raises:
            TrajectoryError: a camera's dataset has no images, or too large ones.
        """
        if self._pictures is None:
            rows = ((path, data) for path, data in self.datasets.items() if data.shape[:1] == (len(self),))
            series = (("/".join(path), image_datasets.image_series(path, dataset)) for path, dataset in rows)
            self._pictures = {name: picture for name, picture in series if picture is not None}
        return self._pictures

    @property
    def columns(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """Datasets of numbers and text with one row per step: (shape of a row, dtype) by path; "str" for text."""
        columns = {}
        for path, dataset in self.datasets.items():
            name, kind = "/".join(path), self._read_as(path, dataset)[0]
            if kind in ("row", "text") and name not in self.pictures:
                columns[name] = (tuple(dataset.shape[1:]), dataset.dtype.name if kind == "row" else "str")
        return columns

    @property
    def rest(self) -> dict[str, Any]:
        """Constants by name, as plain data: attributes of the file, and datasets that are neither column nor image.

        JSON is not parsed; large datasets are left out.
        """
        excluded = {*self.columns, *self.pictures}
        facts = {name: storage.plain(value) for name, value in self.file.attrs.items()}
        for path, dataset in self.datasets.items():
            name = "/".join(path)
            if name not in excluded and dataset.size <= storage.MOST_FACT:
                facts[name] = storage.plain(dataset[()])
        return facts

    def form(self, camera: str) -> tuple[int, int, str]:
        """Return (height, width, encoding) of a camera's colour images; see `ImageSeries`.

        Raises:
            KeyError: there is no such camera.
            TrajectoryError: the first image cannot be read.
        """
        _, dataset = self._camera(camera, spec.Camera.COLOR)
        picture = self.pictures.get(dataset.name.lstrip("/"))
        if picture is None:
            raise TrajectoryError(f"{storage.describe(dataset)}: expected images, got {dataset.shape} {dataset.dtype}")
        return picture.height, picture.width, picture.encoding

    def observation(self, step: int, cameras: Collection[str] | None = None) -> dict[str, Any]:
        """Return the observation of a step, with decoded RGB images.

        It contains `privileged` if that was recorded; remove it for a policy that must not use it.

        Args:
            step: index of the step; negative values count from the end.
            cameras: cameras to read; None for all.

        Raises:
            IndexError: there is no such step.
            TrajectoryError: a dataset cannot be read; the text names it.
        """

        def is_selected(path: names.DatasetPath) -> bool:
            if path[0] == spec.Trajectory.VISION and cameras is not None:
                return path[1] in cameras
            return path[0] != spec.Trajectory.ACTION

        return self._tree(self._check_step(step), is_selected)

    def action(self, step: int) -> dict[str, Any]:
        """Return the action of a step, commanded after its observation; raises like `observation`."""
        tree = self._tree(self._check_step(step), lambda path: path[0] == spec.Trajectory.ACTION)
        action: dict[str, Any] = tree.get(spec.Trajectory.ACTION, {})
        return action

    def facts(self, step: int) -> dict[str, Any]:
        """Return the metadata of a step, as passed to `Writer.add`; raises like `observation`."""
        index, facts = self._check_step(step), {}
        for path, dataset in self.datasets.items():
            if path[:2] == (INFO, names.STEPS) and not names.is_ground_truth(path):
                facts["/".join(path[2:])] = self._value(path, dataset, index)
        return facts

    def image(self, camera: str, step: int) -> np.ndarray:
        """Return a camera's colour image, (H, W, 3) uint8 RGB.

        Raises:
            KeyError: there is no such camera.
            IndexError: there is no such step.
            TrajectoryError: the image cannot be decoded.
        """
        path, dataset = self._camera(camera, spec.Camera.COLOR)
        image: np.ndarray = self._value(path, dataset, self._check_step(step))
        return image

    def depth(self, camera: str, step: int) -> np.ndarray:
        """Return a camera's depth image, (H, W) float, metres; raises like `image`."""
        path, dataset = self._camera(camera, spec.Camera.DEPTH)
        depth: np.ndarray = self._value(path, dataset, self._check_step(step))
        return depth

    def frames(self, name: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield decoded images of one of `pictures`.

        Args:
            name: path in the file, a key of `pictures`.
            start: first step, from 0.
            stop: step after the last one; None for all.

        Yields:
            (H, W, 3) uint8 RGB, or (H, W) depth as stored.

        Raises:
            KeyError: there are no such images.
            TrajectoryError: one cannot be decoded.
        """
        picture = self.pictures.get(name)
        if picture is None:
            raise KeyError(f"{self.path} has no images {name}; it has {', '.join(self.pictures) or 'none at all'}")
        dataset = self.datasets[tuple(name.split("/"))]
        steps = range(*slice(start, stop).indices(len(self)))
        if picture.encoding != "raw":
            yield from (image_datasets.decode_row(dataset, *one) for one in image_datasets.read_encoded(dataset, steps))
            return
        for step in steps:
            image = storage.rows(dataset, step)
            yield image[..., 0] if picture.kind == spec.Camera.DEPTH and image.ndim == 3 else image

    def _camera(self, camera: str, leaf: str) -> tuple[names.DatasetPath, HDF5Dataset]:
        for path, dataset in self.datasets.items():
            if names.is_image(path, leaf) and path[1] == camera:
                return path, dataset
        cameras = self.cameras if leaf == spec.Camera.COLOR else self.depth_cameras
        raise KeyError(f"{self.path} has no {leaf} of {camera!r}; it has that of {', '.join(cameras) or 'no camera'}")

    def _tree(self, step: int, is_selected: Callable[[names.DatasetPath], bool]) -> dict[str, Any]:
        tree: dict[str, Any] = {}
        for path, dataset in self.datasets.items():
            is_fact = path[:2] in ((INFO, names.EPISODE), (INFO, names.STEPS)) or path == (spec.Trajectory.SUBTASKS,)
            if (is_fact and not names.is_ground_truth(path)) or not is_selected(path):
                continue
            value = self._value(path, dataset, step)
            if value is not NO_VALUE:
                *groups, leaf = names.observation_path(path)
                inner = tree
                for name in groups:
                    inner = inner.setdefault(name, {})
                inner[leaf] = value
        several = tree.get(spec.Obs.INSTRUCTIONS)
        if several and spec.Obs.INSTRUCTION not in tree:
            tree[spec.Obs.INSTRUCTION] = several[0]
        return tree
