"""A summary of a dataset, as JSON values and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final, Self

from xpl import _spec as sdk
from xpl.trajectory.ground_truth import LEFT_OUT, RECORDED

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Demonstrations, RecordedEpisode

_MOST_SHOWN: Final = 20


@dataclass(frozen=True)
class PrivilegedRecord:
    """Which privileged information of a simulator an episode holds, and why other parts were left out."""

    recorded: list[str]
    left_out: dict[str, str]

    @classmethod
    def of(cls, episode: RecordedEpisode) -> Self | None:
        """Return the record of an episode; None if it has none."""
        record = episode.extras.get(sdk.Obs.PRIVILEGED)
        if not isinstance(record, Mapping) or not isinstance(record.get(RECORDED), list):
            return None
        left_out = record.get(LEFT_OUT)
        return cls(list(map(str, record[RECORDED])), dict(left_out) if isinstance(left_out, Mapping) else {})


@dataclass(frozen=True)
class EpisodeSummary:
    """Key, length and instructions of one episode."""

    key: str
    steps: int
    instructions: tuple[str, ...]

    @classmethod
    def of(cls, episode: RecordedEpisode) -> Self:
        """Summarise an episode, without keeping a reference to it."""
        return cls(episode.key, episode.length, episode.instructions)


@dataclass(frozen=True)
class DatasetSummary:
    """A dataset's metadata and its episodes; columns, cameras and privileged information are those of the first."""

    path: str
    format: str
    rate_hz: float | None
    robot: str | None
    columns: Mapping[str, ColumnInfo]
    cameras: Mapping[str, CameraInfo]
    privileged: PrivilegedRecord | None
    episodes: tuple[EpisodeSummary, ...]

    @classmethod
    def of(cls, demonstrations: Demonstrations) -> Self:
        """Summarise a dataset."""
        first = demonstrations[0] if len(demonstrations) else None
        return cls(
            demonstrations.path,
            demonstrations.format,
            demonstrations.rate_hz,
            demonstrations.robot,
            first.columns if first else {},
            first.cameras if first else {},
            PrivilegedRecord.of(first) if first else None,
            tuple(EpisodeSummary.of(demonstrations[index]) for index in range(len(demonstrations))),
        )

    def as_json(self) -> dict[str, Any]:
        """The summary as JSON values."""
        columns = {
            name: {"shape": list(column.shape), "dtype": column.dtype, "names": list(column.names)}
            for name, column in self.columns.items()
        }
        keys = ("height", "width", "kind", "encoding")
        cameras = {name: {key: getattr(camera, key) for key in keys} for name, camera in self.cameras.items()}
        return {
            "path": self.path,
            "format": self.format,
            "rate_hz": self.rate_hz,
            "robot": self.robot,
            "columns": columns,
            "cameras": cameras,
            sdk.Obs.PRIVILEGED: None if self.privileged is None else asdict(self.privileged),
            "episodes": [{**asdict(one), sdk.Obs.INSTRUCTIONS: list(one.instructions)} for one in self.episodes],
        }

    @property
    def text(self) -> str:
        """The summary as text."""
        rate = f"{self.rate_hz:g} Hz" if self.rate_hz else "rate unknown"
        lines = [f"{self.path}: {self.format}, {self.robot or 'robot unknown'}, {rate}"]
        if self.episodes:
            steps = [episode.steps for episode in self.episodes]
            lines.append(f"{len(steps)} episodes, {sum(steps)} steps ({min(steps)} to {max(steps)} each)")
        lines += _rows("column", {name: _column(column) for name, column in self.columns.items()})
        lines += _rows("camera", {name: _camera(camera) for name, camera in self.cameras.items()})
        if self.privileged is not None:
            left_out = ", ".join(self.privileged.left_out)
            without = f", without {left_out}" if left_out else ""
            recorded = ", ".join(self.privileged.recorded)
            lines.append(f"  privileged information: {recorded}{without}")
        sentences = Counter(
            sentence for episode in self.episodes for sentence in episode.instructions or ["(no instruction)"]
        )
        lines += [f"  {count:5d} x {sentence}" for sentence, count in sentences.most_common(_MOST_SHOWN)]
        if len(sentences) > _MOST_SHOWN:
            lines.append(f"  and {len(sentences) - _MOST_SHOWN} other instructions")
        return "\n".join(lines)


def _rows(kind: str, entries: Mapping[str, str]) -> list[str]:
    width = max(map(len, entries), default=0)
    return [f"  {kind}  {name.ljust(width)}  {what}" for name, what in entries.items()]


def _column(column: ColumnInfo) -> str:
    shape = " x ".join(map(str, column.shape)) or "number"
    return f"{shape} {column.dtype}" + (f"  {' '.join(column.names)}" if column.names else "")


def _camera(camera: CameraInfo) -> str:
    return f"{camera.height} x {camera.width} {camera.kind} {camera.encoding}"
