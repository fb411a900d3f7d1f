"""Episodes of which all but rows and images is read at once, when something is asked for."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from xpl_cli.data.sets.interface import Episode, Extras

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import Camera, Column


@dataclass(frozen=True)
class Outline:
    """What an episode says without its rows and images: see `Episode`."""

    length: int
    instructions: tuple[str, ...]
    columns: Mapping[str, Column]
    cameras: Mapping[str, Camera]
    extras: Extras = field(default_factory=dict)


class DescribedEpisode(Episode):
    """An episode that something else describes: an outline, or another episode.

    Args:
        key: its name in the set.
    """

    def __init__(self, key: str) -> None:
        self._key = key

    @property
    def _described(self) -> Outline | Episode:
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
    def columns(self) -> Mapping[str, Column]:
        """The columns of numbers and texts."""
        return self._described.columns

    @property
    def cameras(self) -> Mapping[str, Camera]:
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
