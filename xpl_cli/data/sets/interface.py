"""What every reader of demonstrations offers, in the words and conventions of the file that it reads.

A reader's classes inherit from these two, and leave out what their format does not say.

Nothing is converted here: a column is what the file has, under the file's own name. Which column is which part of the
standard, and under which conventions, is said by a mapping, or measured by a probe.
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
"""What is said of a set or an episode beside columns and cameras: plain data under the file's own names."""


@dataclass(frozen=True)
class ColumnInfo:
    """A column of numbers: one row for each step.

    Attributes:
        shape: the shape of a row, `(7,)` for seven joints, `()` for a number.
        dtype: numpy's name of its type, as stored.
        names: what the file calls each entry of a row, if it does; else empty.
    """

    shape: tuple[int, ...]
    dtype: str
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class CameraInfo:
    """A camera: one image for each step.

    Attributes:
        height: in pixels.
        width: in pixels.
        kind: `color`, (H, W, 3) uint8 in the file's own order of channels, or `depth`, (H, W) in the file's unit.
        encoding: how images lie in the file: `raw`, `jpeg`, `png`, or a video's codec (`av1`, `h264`).
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
        path: the file.
        begins_s: when it begins there.
        codec: as the set names it.
    """

    path: str
    begins_s: float
    codec: str


class RecordedEpisode(Protocol):
    """One recorded episode. Opening it reads no images and no columns."""

    @property
    def key(self) -> str:
        """Its name in the set, unique there: `episode_000003`, `demo_12`."""

    @property
    def length(self) -> int:
        """How many steps it has."""

    @property
    def instructions(self) -> tuple[str, ...]:
        """What the robot was told; several where the file has several wordings; empty where it has none."""
        return ()

    @property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The columns of numbers, by the file's names; groups are joined by `/`."""

    @property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras, by the file's names; groups are joined by `/`, as of columns."""

    @property
    def extras(self) -> Extras:
        """What else the file says of this episode, plain data under the file's names."""
        return {}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows `start` to `stop` of a column, (steps, *shape) of its dtype.

        Raises:
            KeyError: there is no such column.
            DataError: the file cannot be read there.
        """

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images `start` to `stop` of a camera, decoded one after the other: uint8, or depth as it is stored.

        Raises:
            KeyError: there is no such camera.
            DataError: an image cannot be decoded; it says which.
        """

    def video(self, camera: str) -> VideoClip | None:  # noqa: ARG002 - of most formats there is none
        """Return where a camera's video lies, which a writer of videos copies; None where its images are none."""
        return None

    def stats(self, camera: str) -> Mapping[str, Any] | None:  # noqa: ARG002 - likewise
        """Return the statistics of a camera's images that the set has, as LeRobot names them; None if it has none."""
        return None


class Demonstrations(Protocol):
    """A set of episodes. Opening it lists them and reads none.

    Args:
        path: the file or folder.
        name: of its format.

    Attributes:
        path: the file or folder.
        format: the name of its format: `xpl`, `lerobot-v2.1`, `lerobot-v3.0`, `robomimic`, `aloha`, `robotwin`, ...
        is_forkable: whether processes that are forked from one that opened it may read it: not where threads do it.
    """

    path: str
    format: str
    is_forkable: bool = True

    def __init__(self, path: str | Path, name: str) -> None:
        self.path, self.format = str(path), name

    @property
    def rate_hz(self) -> float | None:
        """Steps per second, if the set says so."""
        return None

    @property
    def robot(self) -> str | None:
        """What the set calls its robot, if it does."""
        return None

    @property
    def extras(self) -> Extras:
        """What else the set says of itself, plain data under its own names."""
        return {}

    def __len__(self) -> int:
        """How many episodes there are."""

    def __getitem__(self, index: int) -> RecordedEpisode:
        """Return an episode, by its place."""
