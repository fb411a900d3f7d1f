"""Wrappers of a dataset and of an episode, which delegate to the wrapped one by default."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from xpl_cli.data.sets.interface import Demonstrations, Extras
from xpl_cli.data.sets.outlined import DescribedEpisode

if TYPE_CHECKING:
    import numpy as np

    from xpl_cli.data.sets.interface import RecordedEpisode


class DelegatingSet(Demonstrations):
    """A wrapper of a dataset; `_wrap` wraps its episodes.

    Args:
        inner: the wrapped dataset.
        name: of the format whose names the wrapper has; None for that of `inner`.
    """

    def __init__(self, inner: Demonstrations, name: str | None = None) -> None:
        super().__init__(inner.path, name or inner.format)
        self._inner = inner
        self.is_forkable = inner.is_forkable

    @property
    def base_format(self) -> str:
        """The format of the files."""
        return base_format(self._inner)

    @property
    def rate_hz(self) -> float | None:
        """Steps per second, if the dataset has them."""
        return self._inner.rate_hz

    @property
    def robot(self) -> str | None:
        """The robot's name in the dataset, if it has one."""
        return self._inner.robot

    @property
    def extras(self) -> Extras:
        """Other metadata of the dataset."""
        return self._inner.extras

    def __len__(self) -> int:
        """The number of episodes."""
        return len(self._inner)

    def __getitem__(self, index: int) -> RecordedEpisode:
        """Return an episode by its index."""
        return self._wrap(self._inner[index])

    def _wrap(self, episode: RecordedEpisode) -> RecordedEpisode:
        raise NotImplementedError


class DelegatingEpisode(DescribedEpisode):
    """A wrapper of an episode.

    Args:
        inner: the wrapped episode.
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
    """Return the format of a dataset's files, below all wrappers."""
    return demonstrations.base_format if isinstance(demonstrations, DelegatingSet) else demonstrations.format
