"""A dataset of LeRobot: `meta/info.json` and `meta/stats.json`.

Source: huggingface/lerobot src/lerobot/datasets/ (DEFAULT_FEATURES, INFO_PATH, STATS_PATH); `names` is a list, or a map
with one list in it ("motors", "axes").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.layout import DataRange
from xpl_cli.adopt.facts import Evidence, Fact, certain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument

INFO: Final = "meta/info.json"
STATS: Final = "meta/stats.json"


@dataclass(frozen=True)
class LeRobotDataset:
    """A LeRobot dataset's metadata of its features."""

    info: ConfigDocument
    stats: ConfigDocument | None

    @property
    def rate(self) -> Fact | None:
        """Frames per second."""
        fps = self.info.get(float, "fps", default=None)
        return certain(_integer_if_whole(fps), self.info.evidence_of("fps")) if fps else None

    @property
    def robot(self) -> Fact | None:
        """The robot's name in the dataset."""
        name = self.info.get(str, "robot_type", default="")
        return certain(name, self.info.evidence_of("robot_type")) if name else None

    def names(self, feature: str) -> tuple[Sequence[str], Evidence] | None:
        """Return the names of a feature's numbers, and their source."""
        path: tuple[str, ...] = ("features", feature, "names")
        labels = self.info.texts(*path)
        inner = self.info.at(*path)
        if labels is None and isinstance(inner, dict) and len(inner) == 1:
            path = (*path, next(iter(inner)))
            labels = self.info.texts(*path)
        if labels is None:
            return None
        return labels, Evidence(self.info.file, self.info.line(*path), "names")

    def range(self, feature: str) -> DataRange | None:
        """Return the range of a feature."""
        return None if self.stats is None else DataRange.read(self.stats, (feature,), "min", "max")


def recognises(folder: CheckpointFolder) -> bool:
    """Tell whether a folder is a dataset of LeRobot."""
    return folder.has(INFO)


def read(folder: CheckpointFolder) -> LeRobotDataset:
    """Read a dataset's metadata.

    Raises:
        UserError: a file is invalid.
    """
    return LeRobotDataset(folder.json(INFO), folder.json(STATS) if folder.has(STATS) else None)


def _integer_if_whole(value: float) -> float:
    return int(value) if value == int(value) else value
