"""Episodes whose outline (everything but rows and images) is read once, on first access."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from xpl_cli.data.sets.interface import Extras, RecordedEpisode

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo


@dataclass(frozen=True)
class Outline:
    """An episode without its rows and images; the fields are those of `RecordedEpisode`."""

    length: int
    instructions: tuple[str, ...]
    columns: Mapping[str, ColumnInfo]
    cameras: Mapping[str, CameraInfo]
    extras: Extras = field(default_factory=dict)


class DescribedEpisode(RecordedEpisode):
    """An episode whose properties come from an outline or from another episode.

    Args:
        key: its name in the dataset.
    """

    def __init__(self, key: str) -> None:
        self._key = key

    @property
    def _described(self) -> Outline | RecordedEpisode:
        raise NotImplementedError

    @property
    def key(self) -> str:
        """Its name in the dataset."""
        return self._key

    @property
    def length(self) -> int:
        """The number of steps."""
        return self._described.length

    @property
    def instructions(self) -> tuple[str, ...]:
        """The language instructions."""
        return self._described.instructions

    @property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The columns."""
        return self._described.columns

    @property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras."""
        return self._described.cameras

    @property
    def extras(self) -> Extras:
        """Other metadata."""
        return self._described.extras


class OutlinedEpisode(DescribedEpisode):
    """An episode that takes its properties from its outline; formats implement `outline`, `read` and `frames`."""

    @functools.cached_property
    def _described(self) -> Outline:
        return self.outline()

    def outline(self) -> Outline:
        """Read everything but rows and images; called once."""
        raise NotImplementedError
