"""The sample that a probe reads: the numbers of evenly spread episodes, and the role of each column."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

STATE, COMMAND, OTHER = "state", "command", "other"
_COMMANDS: Final = frozenset(("action", "actions", "command", "commands", "target", "targets", "ctrl", "desired"))
_CLOCKS: Final = frozenset(("timestamp", "timestamps", "time", "times", "stamp"))
_OTHERS: Final = frozenset(
    [
        "reward",
        "rewards",
        "done",
        "dones",
        "success",
        "index",
        "discount",
        "terminal",
        "last",
        "first",
        "velocity",
        "velocities",
        "vel",
        "qvel",
        "effort",
        "torque",
        "force",
        "current",
        "wrench",
        "progress",
        "subtask",
        "intrinsic",
        "intrinsics",
        "extrinsic",
        "extrinsics",
        "mask",
        "info",
        "additional",
        "meta",
        "env",
        "environment",
        "privileged",
        "asked",
        "steps",
        "delta",
        "twist",
        "twists",
        "valid",
        "padding",
    ]
)
"""Words in names of columns that are neither state nor command."""
_WIDEST: Final = 64
_ROWS: Final = 6000
"""Rows that are read in all: 6,000 are 4 minutes at 25 Hz, and more add nothing."""


@dataclass(frozen=True)
class Series:
    """One column of the episodes that were read.

    Attributes:
        name: the file's.
        role: state, command or other.
        rows: of each episode, (T, D) float64.
        names: the file's name of each number, if it has one.
    """

    name: str
    role: str
    rows: tuple[np.ndarray, ...]
    names: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """Numbers of a row."""
        return int(self.rows[0].shape[1])

    @property
    def stacked(self) -> np.ndarray:
        """The rows of all episodes, (N, D)."""
        return np.concatenate(self.rows)


@dataclass(frozen=True)
class Sample:
    """A sample of a dataset.

    Attributes:
        series: its columns of numbers.
        episodes: the episodes.
        steps: number of steps that were read.
    """

    series: tuple[Series, ...]
    episodes: tuple[RecordedEpisode, ...]
    steps: int

    def of(self, role: str) -> list[Series]:
        """Return the columns of a role."""
        return [one for one in self.series if one.role == role]


def spread(count: int, most: int) -> list[int]:
    """Return up to `most` of `count` indices, evenly spread, with the first and the last."""
    if count <= most:
        return list(range(count))
    return sorted({round(position) for position in np.linspace(0, count - 1, most)})


def words(name: str) -> list[str]:
    """Return the words of a name: `observation.state.left_arm` has four."""
    return [word.lower() for word in re.split(r"[^A-Za-z0-9]+|_", name) if word]


def role_of(name: str) -> str:
    """Return the role of a column by the words of its name."""
    name_words = words(name)
    is_command = bool(set(name_words) & _COMMANDS)
    others = _OTHERS | _CLOCKS
    if set(name_words) & (others - {"delta"} if is_command else others):
        return OTHER
    return COMMAND if is_command else STATE


def is_clock(name: str) -> bool:
    """Tell whether a column is one of times, by the words of its name."""
    return bool(set(words(name)) & _CLOCKS)


def read_sample(
    demonstrations: Demonstrations, most: int, report_progress: Callable[[str], None] = lambda _: None
) -> Sample:
    """Read the numbers of up to `most` episodes, evenly spread; images are not read.

    Raises:
        DataError: a column cannot be read.
    """
    indices = spread(len(demonstrations), most)
    episodes: list[RecordedEpisode] = []
    rows: dict[str, list[np.ndarray]] = {}
    names: dict[str, tuple[str, ...]] = {}
    read = 0
    for index in indices:
        episode = demonstrations[index]
        if read >= _ROWS or episode.length < 2:
            continue
        report_progress(f"{episode.key}: numbers")
        for name, column in episode.columns.items():
            if not np.issubdtype(np.dtype(column.dtype), np.number) and column.dtype != "bool":
                continue
            if 0 < (width := math.prod(column.shape)) <= _WIDEST:
                values = np.asarray(episode.read(name, 0, _ROWS), np.float64)
                rows.setdefault(name, []).append(values.reshape(len(values), width))
                names.setdefault(name, column.names)
        episodes.append(episode)
        read += min(episode.length, _ROWS)
    series = [
        Series(name, role_of(name), tuple(values), names[name])
        for name, values in rows.items()
        if len(values) == len(episodes) and len({entry.shape[1] for entry in values}) == 1
    ]
    return Sample(tuple(series), tuple(episodes), read)
