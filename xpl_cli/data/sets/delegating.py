"""A set, or an episode, that stands around another one: what it does not say otherwise is the other's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from xpl_cli.data.sets.interface import Demonstrations, Extras
from xpl_cli.data.sets.outlined import DescribedEpisode

if TYPE_CHECKING:
    import numpy as np

    from xpl_cli.data.sets.interface import RecordedEpisode


class DelegatingSet(Demonstrations):
    """A set around another one; `_around` makes its episodes.

    Args:
        inner: the other one.
        name: of the format that it speaks; None for that of the other one.
    """

    def __init__(self, inner: Demonstrations, name: str | None = None) -> None:
        super().__init__(inner.path, name or inner.format)
        self._inner = inner
        self.is_forkable = inner.is_forkable

    @property
    def base_format(self) -> str:
        """The name of the format of the files."""
        return base_format(self._inner)

    @property
    def rate_hz(self) -> float | None:
        """Steps per second, if the set says so."""
        return self._inner.rate_hz

    @property
    def robot(self) -> str | None:
        """What the set calls its robot, if it does."""
        return self._inner.robot

    @property
    def extras(self) -> Extras:
        """What else the set says of itself."""
        return self._inner.extras

    def __len__(self) -> int:
        """How many episodes there are."""
        return len(self._inner)

    def __getitem__(self, index: int) -> RecordedEpisode:
        """Return an episode, by its place."""
        return self._wrap(self._inner[index])

    def _wrap(self, episode: RecordedEpisode) -> RecordedEpisode:
        raise NotImplementedError


class DelegatingEpisode(DescribedEpisode):
    """An episode around another one.

    Args:
        inner: the other one.
    """

    def __init__(self, inner: RecordedEpisode) -> None:
        super().__init__(inner.key)
        self._inner = inner

    @property
    def _described(self) -> RecordedEpisode:
        return self._inner

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        return self._inner.read(column, start, stop)

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """Yield images of a camera."""
        return self._inner.frames(camera, start, stop)


def base_format(demonstrations: Demonstrations) -> str:
    """Return the name of the format of the files of a set, whatever stands around it."""
    return demonstrations.base_format if isinstance(demonstrations, DelegatingSet) else demonstrations.format
