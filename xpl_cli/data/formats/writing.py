"""The interface of dataset writers: episodes are written in any order and process, then joined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Extras, RecordedEpisode

CONVERTED: Final = "converted"
"""Key of a converted dataset's provenance: the source's format, and the names that were changed."""
IMAGES: Final = ("auto", "video", "png", "jpeg", "raw")
VIDEO: Final = {"av1": "libsvtav1", "h264": "libx264"}
"""Encoders of videos, by codec."""


@dataclass(frozen=True)
class WriteOptions:
    """Choices of an output format.

    Attributes:
        images: encoding of camera images; `auto` is the format's default.
        codec: of videos.
        crf: constant rate factor of videos; smaller is better.
        file_mb: size at which a format that joins episodes starts another file, MB; None for the format's default.
    """

    images: str = "auto"
    codec: str = "av1"
    crf: int = 30
    file_mb: float | None = None


@dataclass(frozen=True)
class WritePlan:
    """Facts of the whole dataset, gathered before the first episode is written.

    Attributes:
        rate_hz: steps per second; None if unknown.
        robot: the robot's name in the dataset.
        lengths: steps of each episode.
        instructions: of each episode.
        columns: of the first episode, by the names that are written.
        cameras: likewise.
        extras: other metadata of the dataset.
        options: choices of the format.
    """

    rate_hz: float | None
    robot: str | None
    lengths: tuple[int, ...]
    instructions: tuple[tuple[str, ...], ...]
    columns: Mapping[str, ColumnInfo]
    cameras: Mapping[str, CameraInfo]
    extras: Extras = field(default_factory=dict)
    options: WriteOptions = field(default_factory=WriteOptions)

    @property
    def starts(self) -> tuple[int, ...]:
        """The first step of each episode, counted over the whole dataset."""
        total, starts = 0, []
        for length in self.lengths:
            starts.append(total)
            total += length
        return tuple(starts)


@dataclass(frozen=True)
class NamingScheme:
    """The names that a format gives to common columns; a column that matches none keeps its name.

    Attributes:
        action: the column of actions.
        state: the column of the state; "" if there is no single one.
        within: prefix of other observations.
        camera: prefix of cameras.
        separator: between groups; it replaces `/` in names.
        environment: the column of the simulator's ground truth; "" if there is none.
    """

    action: str
    state: str
    within: str
    camera: str
    separator: str = "/"
    environment: str = ""


@dataclass(frozen=True)
class WrittenEpisode:
    """What `finish` needs to know of a written episode; it is stored as JSON until then.

    Attributes:
        psnr_db: lowest PSNR of the sampled frames, by lossily encoded camera.
        videos: codec, by camera that became a video.
        stats: statistics, by column and camera.
        extras: other metadata, where the format stores it for all episodes together.
    """

    psnr_db: Mapping[str, float] = field(default_factory=dict)
    videos: Mapping[str, str] = field(default_factory=dict)
    stats: Mapping[str, Mapping[str, list[Any]]] = field(default_factory=dict)
    extras: Extras = field(default_factory=dict)


class DatasetWriter(Protocol):
    """Writes datasets of one format."""

    name: str
    names: NamingScheme

    def column_rejection(self, column: ColumnInfo) -> str | None:
        """Return why the format cannot hold a column; None if it can."""

    def camera_rejection(self, camera: CameraInfo) -> str | None:
        """Return why the format cannot hold a camera; None if it can."""

    def check(self, plan: WritePlan) -> None:
        """Check the plan before anything is written.

        Raises:
            DataError: the format needs something that the plan lacks.
        """

    def write_episode(self, folder: Path, plan: WritePlan, index: int, episode: RecordedEpisode) -> WrittenEpisode:
        """Write one episode below a folder; return what `finish` needs to know of it.

        It may be called again for an episode that was written in part.
        """

    def finish(self, folder: Path, plan: WritePlan, pieces: list[WrittenEpisode]) -> Path:
        """Join the episodes; return the file or folder of the dataset."""
