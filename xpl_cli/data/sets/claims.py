"""What a set claims of itself, held against its size: a small file can claim any number of anything.

Bounds of one process (`limits.py`) end what takes too long for one answer; these end what asks for too many.
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
"""Bytes of pixels for each byte of a set, at most: of images one by one, and of videos, which tell what changes."""
_NO_NAMES: Final = {"", ".", ".."}
_ROW_BYTES: Final = 8
"""Bytes of a step, at least: whoever counts steps needs as much."""
_FEW_EPISODES: Final = 1000
_EPISODE_BYTES: Final = 256
"""Bytes of a set for each of its episodes, at least: three steps of an arm take as much."""


@dataclass
class SizeClaims:
    """What was claimed so far by a set.

    Args:
        path: of the set.
        size: bytes of its files.
    """

    path: str
    size: int
    _seen: set[int] = field(default_factory=set)
    _answered: set[int] = field(default_factory=set)
    _numbers: int = 0
    _pixels: dict[bool, int] = field(default_factory=lambda: {False: 0, True: 0})

    def add_set(self, found: Demonstrations) -> None:
        """Take a set that was opened.

        Raises:
            DataError: it claims more episodes than its files can hold.
        """
        most = _FEW_EPISODES + self.size // _EPISODE_BYTES
        if len(found) > most:
            raise self._error(f"it lists {len(found)} episodes, and files of {self.size} bytes hold {most} at most")

    def check_rate(self, rate_hz: float | None) -> None:
        """Take the steps per second that a set says.

        Raises:
            DataError: no robot has as few or as many.
        """
        if rate_hz is not None and not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise self._error(f"it says {rate_hz:g} steps per second, expected {SLOWEST_HZ:g} to {FASTEST_HZ:g}")

    def add_episode(self, index: int, episode: RecordedEpisode) -> None:
        """Take the outline of an episode.

        Raises:
            DataError: it has no steps, or the set claims more of anything than its files can hold.
        """
        if episode.length < 1:
            raise self._error(f"{episode.key} has no steps, expected one at least")
        self._check_names(episode)
        for name, camera in episode.cameras.items():
            if camera.height * camera.width > MOST_PIXELS:
                told = f"images of {camera.height} x {camera.width} pixels, expected {MOST_PIXELS} in all at most"
                raise self._error(f"{episode.key}: {name} has {told}")
        if index not in self._seen:
            self._seen.add(index)
            self._count(episode)
        self._check_limit("numbers", self._numbers, storage.most_read(self.size))
        for is_video, pixels in self._pixels.items():
            most = _FEW_IMAGES + _UNPACKED[is_video] * self.size
            self._check_limit("videos" if is_video else "images", pixels, most)

    def add_metadata(self, index: int, size: int) -> None:
        """Take the bytes of what an episode says without its rows and images, which count as numbers.

        Raises:
            DataError: with those before they are more than the set's files can hold.
        """
        if index not in self._answered:
            self._answered.add(index)
            self._numbers += size
        self._check_limit("numbers and facts", self._numbers, storage.most_read(self.size))

    def checked_images(
        self, episode: RecordedEpisode, camera: str, start: int, frames: Iterable[NDArray[np.uint8]]
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera from a step on, as long as they have its size, by which they were counted.

        Raises:
            DataError: one has another size.
        """
        known = episode.cameras[camera]
        for step, image in enumerate(frames, start):
            height, width = image.shape[:2]
            if (height, width) != (known.height, known.width):
                told = f"{episode.key}: {camera} has an image of {height} x {width} pixels at step {step}"
                raise self._error(f"{told}, expected {known.height} x {known.width} as for the camera")
            yield image

    def _check_names(self, episode: RecordedEpisode) -> None:
        columns, cameras = episode.columns, episode.cameras
        for word, count, most in (("columns", len(columns), MOST_COLUMNS), ("cameras", len(cameras), MOST_CAMERAS)):
            if count > most:
                raise self._error(f"{episode.key} has {count} {word}, expected {most} at most")
        for name in (episode.key, *columns, *cameras):
            if not name.isprintable() or len(name) > MOST_LETTERS or _NO_NAMES.intersection(name.split("/")):
                told = ascii(name)[:MOST_LETTERS]
                raise self._error(f"it has the name {told}, expected a short one that can be printed")

    def _count(self, episode: RecordedEpisode) -> None:
        numbers = [one for one in episode.columns.values() if one.dtype != "str"]
        row = sum(math.prod(one.shape) * np.dtype(one.dtype).itemsize for one in numbers)
        self._numbers += episode.length * max(row, _ROW_BYTES)
        for name, camera in episode.cameras.items():
            image = 3 * camera.height * camera.width
            self._pixels[episode.video(name) is not None] += episode.length * image

    def _check_limit(self, what: str, claimed: int, most: int) -> None:
        if claimed > most:
            told = f"{claimed} bytes of {what} in the episodes so far"
            raise self._error(f"it claims {told}, and files of {self.size} bytes hold {most} at most")

    def _error(self, what: str) -> DataError:
        return DataError(f"{self.path}: {what}", code=ExitCode.FINDINGS)
