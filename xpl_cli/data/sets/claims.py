"""Plausibility checks of a dataset's claimed counts and sizes against the size of its files.

`limits.py` limits one answer of the reader process; these checks limit the number of answers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl.trajectory import storage
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from xpl_cli.data.sets.interface import Demonstrations, RecordedEpisode

MOST_COLUMNS: Final = 512
MOST_CAMERAS: Final = 64
MOST_LETTERS: Final = 200
MOST_PIXELS: Final = 1 << 24
"""Of one image, a little over 5K video."""
SLOWEST_HZ, FASTEST_HZ = 1e-3, 1e6
_FEW_IMAGES: Final = 512 << 20
_UNPACKED: Final = {False: 1 << 10, True: 1 << 14}
"""Most bytes of pixels per byte of the dataset: for images, and for videos, which store changes only."""
_NO_NAMES: Final = {"", ".", ".."}
_ROW_BYTES: Final = 8
"""Fewest bytes per step."""
_FEW_EPISODES: Final = 1000
_EPISODE_BYTES: Final = 256
"""Fewest bytes of a dataset per episode: about three steps of one arm."""


@dataclass
class SizeClaims:
    """Counts what a dataset has claimed so far.

    Args:
        path: of the dataset.
        size: of its files, bytes.
    """

    path: str
    size: int
    _counted_episodes: set[int] = field(default_factory=set)
    _described_episodes: set[int] = field(default_factory=set)
    _numbers: int = 0
    _pixels: dict[bool, int] = field(default_factory=lambda: {False: 0, True: 0})

    def add_set(self, dataset: Demonstrations) -> None:
        """Check the number of episodes of an opened dataset.

        Raises:
            DataError: it claims more episodes than its files can hold.
        """
        most = _FEW_EPISODES + self.size // _EPISODE_BYTES
        if len(dataset) > most:
            raise self._error(f"it lists {len(dataset)} episodes, files of {self.size} bytes hold {most} at most")

    def check_rate(self, rate_hz: float | None) -> None:
        """Check the dataset's steps per second.

        Raises:
            DataError: the rate is outside 0.001 to 1e6 Hz.
        """
        if rate_hz is not None and not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise self._error(f"it has {rate_hz:g} steps per second, expected {SLOWEST_HZ:g} to {FASTEST_HZ:g}")

    def add_episode(self, index: int, episode: RecordedEpisode) -> None:
        """Check and count the outline of an episode.

        Raises:
            DataError: the episode has no steps, or the dataset claims more data than its files can hold.
        """
        if episode.length < 1:
            raise self._error(f"{episode.key} has no steps, expected one at least")
        self._check_names(episode)
        for name, camera in episode.cameras.items():
            if camera.height * camera.width > MOST_PIXELS:
                problem = f"images of {camera.height} x {camera.width} pixels, expected {MOST_PIXELS} in all at most"
                raise self._error(f"{episode.key}: {name} has {problem}")
        if index not in self._counted_episodes:
            self._counted_episodes.add(index)
            self._count(episode)
        self._check_limit("numbers", self._numbers, storage.most_read(self.size))
        for is_video, pixels in self._pixels.items():
            most = _FEW_IMAGES + _UNPACKED[is_video] * self.size
            self._check_limit("videos" if is_video else "images", pixels, most)

    def add_metadata(self, index: int, size: int) -> None:
        """Count the bytes of an episode's outline.

        Raises:
            DataError: the sum exceeds what the dataset's files can hold.
        """
        if index not in self._described_episodes:
            self._described_episodes.add(index)
            self._numbers += size
        self._check_limit("numbers and metadata", self._numbers, storage.most_read(self.size))

    def checked_images(
        self, episode: RecordedEpisode, camera: str, start: int, frames: Iterable[NDArray[np.uint8]]
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera from step `start` on, and check their size.

        Raises:
            DataError: an image has another size than the camera.
        """
        info = episode.cameras[camera]
        for step, image in enumerate(frames, start):
            height, width = image.shape[:2]
            if (height, width) != (info.height, info.width):
                problem = f"{episode.key}: {camera} has an image of {height} x {width} pixels at step {step}"
                raise self._error(f"{problem}, expected {info.height} x {info.width} as for the camera")
            yield image

    def _check_names(self, episode: RecordedEpisode) -> None:
        columns, cameras = episode.columns, episode.cameras
        for kind, count, most in (("columns", len(columns), MOST_COLUMNS), ("cameras", len(cameras), MOST_CAMERAS)):
            if count > most:
                raise self._error(f"{episode.key} has {count} {kind}, expected {most} at most")
        for name in (episode.key, *columns, *cameras):
            if not name.isprintable() or len(name) > MOST_LETTERS or _NO_NAMES.intersection(name.split("/")):
                printable = ascii(name)[:MOST_LETTERS]
                raise self._error(f"it has the name {printable}, expected a short printable name")

    def _count(self, episode: RecordedEpisode) -> None:
        numbers = [one for one in episode.columns.values() if one.dtype != "str"]
        row = sum(math.prod(one.shape) * np.dtype(one.dtype).itemsize for one in numbers)
        self._numbers += episode.length * max(row, _ROW_BYTES)
        for name, camera in episode.cameras.items():
            image = 3 * camera.height * camera.width
            self._pixels[episode.video(name) is not None] += episode.length * image

    def _check_limit(self, what: str, size: int, most: int) -> None:
        if size > most:
            amount = f"{size} bytes of {what} in the episodes so far"
            raise self._error(f"it claims {amount}, files of {self.size} bytes hold {most} at most")

    def _error(self, what: str) -> DataError:
        return DataError(f"{self.path}: {what}", code=ExitCode.FINDINGS)
