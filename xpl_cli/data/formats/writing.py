"""What every writer of a format offers: a piece for each episode, in any order and process, and what joins them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Extras, RecordedEpisode

CONVERTED: Final = "converted"
"""Where a set that was made of another one says so: its format, and the names that had to change."""
IMAGES: Final = ("auto", "video", "png", "jpeg", "raw")
VIDEO: Final = {"av1": "libsvtav1", "h264": "libx264"}
"""Encoders of videos, by codec."""


@dataclass(frozen=True)
class WriteOptions:
    """How things are written where a format leaves a choice.

    Attributes:
        images: how cameras are kept; `auto` is the format's own way.
        codec: of videos.
        crf: quality of videos, the smaller the better.
        file_mb: size at which a format that joins episodes begins another file; None for the format's own.
    """

    images: str = "auto"
    codec: str = "av1"
    crf: int = 30
    file_mb: float | None = None


@dataclass(frozen=True)
class WritePlan:
    """What is known of a whole set before its first episode is written.

    Attributes:
        rate_hz: steps per second, None if nobody knows.
        robot: what the set calls its robot.
        lengths: steps of each episode.
        instructions: of each episode.
        columns: of the first episode, by the names that are written.
        cameras: likewise.
        extras: what else is said of the set.
        options: the choices.
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
        """The first step of each episode, counted over the set."""
        total, found = 0, []
        for length in self.lengths:
            found.append(total)
            total += length
        return tuple(found)


@dataclass(frozen=True)
class NamingScheme:
    """How a format calls what formats have in common; what none of it fits keeps its name.

    Attributes:
        action: the column of actions.
        state: the column of the state, "" if there is no single one.
        within: what stands before other observations.
        camera: what stands before a camera.
        separator: what stands between groups; another one in a name is exchanged for it.
        environment: the column of the simulator's truth, "" if there is none.
    """

    action: str
    state: str
    within: str
    camera: str
    separator: str = "/"
    environment: str = ""


@dataclass(frozen=True)
class WrittenEpisode:
    """What was written of one episode, as the end of a conversion needs to know it; it is kept as JSON meanwhile.

    Attributes:
        psnr_db: by camera whose images were encoded here and lost something, the lowest of a sample.
        videos: by camera that became a video, its codec.
        stats: by column and camera, its statistics.
        extras: what else the episode says, where the format keeps it for all episodes together.
    """

    psnr_db: Mapping[str, float] = field(default_factory=dict)
    videos: Mapping[str, str] = field(default_factory=dict)
    stats: Mapping[str, Mapping[str, list[Any]]] = field(default_factory=dict)
    extras: Extras = field(default_factory=dict)


class DatasetWriter(Protocol):
    """Writes sets of one format."""

    name: str
    names: NamingScheme

    def column_rejection(self, column: ColumnInfo) -> str | None:
        """Return why a column cannot be kept, None if it can."""

    def camera_rejection(self, camera: CameraInfo) -> str | None:
        """Return why a camera cannot be kept, None if it can."""

    def check(self, plan: WritePlan) -> None:
        """Stop before anything is written.

        Raises:
            DataError: something is missing that the format needs.
        """

    def write_episode(self, folder: Path, plan: WritePlan, index: int, episode: RecordedEpisode) -> WrittenEpisode:
        """Write one episode below a folder; return what the finish needs to know of it.

        It may be called again for an episode of which a part was written.
        """

    def finish(self, folder: Path, plan: WritePlan, pieces: list[WrittenEpisode]) -> Path:
        """Join the pieces; return the file or folder that is the set."""
