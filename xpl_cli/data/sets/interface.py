"""The interface of dataset readers: datasets and episodes, under the names and conventions of the file.

A reader's classes inherit from `Demonstrations` and `RecordedEpisode`, and omit what their format does not have.

Nothing is converted here: a column has the file's name and values. A mapping states, or the probe measures, which
column is which part of the standard, and under which conventions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from xpl import _spec as sdk

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np


Extras = Mapping[str, Any]
"""Metadata of a dataset or an episode besides columns and cameras: JSON values under the file's own names."""


@dataclass(frozen=True)
class ColumnInfo:
    """A column of numbers: one row per step.

    Attributes:
        shape: the shape of a row, `(7,)` for seven joints, `()` for a number.
        dtype: numpy's name of its type, as stored.
        names: the file's name of each entry of a row; empty if it has none.
    """

    shape: tuple[int, ...]
    dtype: str
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class CameraInfo:
    """A camera: one image per step.

    Attributes:
        height: in pixels.
        width: in pixels.
        kind: `color`, (H, W, 3) uint8 in the file's own channel order, or `depth`, (H, W) in the file's unit.
        encoding: of the images in the file: `raw`, `jpeg`, `png`, or a video's codec (`av1`, `h264`).
        intrinsics: (3, 3) or (T, 3, 3) float, in pixels, if the file has them.
        extrinsics: (4, 4) or (T, 4, 4) float, as the file has them.
    """

    height: int
    width: int
    kind: str = sdk.Camera.COLOR
    encoding: str = "raw"
    intrinsics: np.ndarray | None = field(default=None, compare=False)
    extrinsics: np.ndarray | None = field(default=None, compare=False)


@dataclass(frozen=True)
class VideoClip:
    """An episode's part of a video.

    Attributes:
        path: of the video.
        begins_s: start of the episode in the video, seconds.
        codec: as the dataset names it.
    """

    path: str
    begins_s: float
    codec: str


class RecordedEpisode(Protocol):
    """One recorded episode. Opening it reads no images and no columns."""

    @property
    def key(self) -> str:
        """Its name, unique in the dataset: `episode_000003`, `demo_12`."""

    @property
    def length(self) -> int:
        """The number of steps."""

    @property
    def instructions(self) -> tuple[str, ...]:
        """The language instruction; several where the file has several wordings; empty where it has none."""
        return ()

    @property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The columns, by the file's names; groups are joined by `/`."""

    @property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras, by the file's names; groups are joined by `/`."""

    @property
    def extras(self) -> Extras:
        """Other metadata of this episode: JSON values under the file's names."""
        return {}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows `start` to `stop` of a column, (steps, *shape) of its dtype.

        Raises:
            KeyError: there is no such column.
            DataError: the file cannot be read there.
        """

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images `start` to `stop` of a camera, decoded one by one: (H, W, 3) uint8, or depth as stored.

        Raises:
            KeyError: there is no such camera.
            DataError: an image cannot be decoded; the message says which.
        """

    def video(self, camera: str) -> VideoClip | None:  # noqa: ARG002 - most formats have none
        """Return a camera's video clip, which a writer can copy; None where the images are not a video."""
        return None

    def stats(self, camera: str) -> Mapping[str, Any] | None:  # noqa: ARG002 - likewise
        """Return the dataset's own statistics of a camera's images, named as in LeRobot; None if it has none."""
        return None


class Demonstrations(Protocol):
    """A dataset of recorded episodes. Opening it lists them and reads none.

    Args:
        path: the file or folder.
        name: of its format.

    Attributes:
        path: the file or folder.
        format: the name of its format: `xpl`, `lerobot-v2.1`, `lerobot-v3.0`, `robomimic`, `aloha`, `robotwin`, ...
        is_forkable: whether a forked process may read the dataset; False for readers that use threads.
    """

    path: str
    format: str
    is_forkable: bool = True

    def __init__(self, path: str | Path, name: str) -> None:
        self.path, self.format = str(path), name

    @property
    def rate_hz(self) -> float | None:
        """Steps per second, if the dataset has them."""
        return None

    @property
    def robot(self) -> str | None:
        """The robot's name in the dataset, if it has one."""
        return None

    @property
    def extras(self) -> Extras:
        """Other metadata of the dataset."""
        return {}

    def __len__(self) -> int:
        """The number of episodes."""

    def __getitem__(self, index: int) -> RecordedEpisode:
        """Return an episode by its index."""
