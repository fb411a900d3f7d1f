"""Episodes of which all but rows and images is read at once, when something is asked for."""

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
    """What an episode says without its rows and images: see `Episode`."""

    length: int
    instructions: tuple[str, ...]
    columns: Mapping[str, ColumnInfo]
    cameras: Mapping[str, CameraInfo]
    extras: Extras = field(default_factory=dict)


class DescribedEpisode(RecordedEpisode):
    """An episode that something else describes: an outline, or another episode.

    Args:
        key: its name in the set.
    """

    def __init__(self, key: str) -> None:
        self._key = key

    @property
    def _described(self) -> Outline | RecordedEpisode:
        raise NotImplementedError

    @property
    def key(self) -> str:
        """Its name in the set."""
        return self._key

    @property
    def length(self) -> int:
        """How many steps it has."""
        return self._described.length

    @property
    def instructions(self) -> tuple[str, ...]:
        """What the robot was told."""
        return self._described.instructions

    @property
    def columns(self) -> Mapping[str, ColumnInfo]:
        """The columns of numbers and texts."""
        return self._described.columns

    @property
    def cameras(self) -> Mapping[str, CameraInfo]:
        """The cameras."""
        return self._described.cameras

    @property
    def extras(self) -> Extras:
        """What else is said of it."""
        return self._described.extras


class OutlinedEpisode(DescribedEpisode):
    """An episode that answers from its outline; `outline`, `read` and `frames` are its format's."""

    @functools.cached_property
    def _described(self) -> Outline:
        return self.outline()

    def outline(self) -> Outline:
        """Read all but rows and images; asked once."""
        raise NotImplementedError
