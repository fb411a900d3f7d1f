"""RLDS, the format of DROID and Open X-Embodiment, read through tensorflow-datasets where that is installed.

Source: github.com/google-research/rlds: an episode is a nested dataset `steps`, each with `observation` and `action`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl.image_codec import PIXELS, size_of
from xpl_cli.data.sets import limits
from xpl_cli.data.sets.errors import DataError, LibraryMissingError
from xpl_cli.data.sets.interface import CameraInfo, ColumnInfo, Demonstrations, Extras
from xpl_cli.data.sets.outlined import Outline, OutlinedEpisode

if TYPE_CHECKING:
    from types import ModuleType

    from numpy.typing import NDArray

NAME: Final = "rlds"
_INFO: Final = "dataset_info.json"
_FEATURES: Final = "features.json"
_TENSORFLOW_BYTES: Final = 2 << 30
"""For its threads and pools."""
_SENTENCES: Final = (
    "language_instruction",
    "natural_language_instruction",
    "language_instruction_2",
    "language_instruction_3",
)
_STEPS: Final = "steps"
_SPLIT: Final = "train"
_AHEAD: Final = 64
"""Episodes that are skipped to reach a later one: reopening the dataset takes longer."""
_MOST_FACT: Final = 1024
"""Largest size of an episode's metadata value, numbers."""


def recognises(path: Path) -> bool:
    """Tell whether a folder is a dataset prepared by tensorflow-datasets."""
    return (path / _INFO).is_file() and (path / _FEATURES).is_file()


def opened(path: Path) -> RldsSet:
    """Return the dataset."""
    return RldsSet(path)


class RldsSet(Demonstrations):
    """A folder with `dataset_info.json`; its split `train`.

    Lengths and instructions need one pass over the dataset, which decodes no image.
    """

    is_forkable = False

    def __init__(self, path: Path) -> None:
        try:
            with limits.outside_limits(_TENSORFLOW_BYTES):
                import tensorflow_datasets as tfds
        except ImportError as error:
            raise LibraryMissingError(
                f"{path} is RLDS, which is read through tensorflow-datasets, and that cannot be imported: {error}",
                hint="pip install tensorflow-datasets tensorflow importlib_resources",
            ) from None
        super().__init__(path, NAME)
        self._tfds = tfds
        self._builder = tfds.builder_from_directory(str(path))
        self._count = int(self._builder.info.splits[_SPLIT].num_examples)
        self._next: tuple[int, Iterator[Any]] | None = None
        self._read: tuple[int, list[dict[str, Any]]] = (-1, [])

    @property
    def extras(self) -> Extras:
        """The dataset's name in tensorflow-datasets."""
        return {"name": self._builder.name}

    def __len__(self) -> int:
        """The number of episodes."""
        return self._count

    def __getitem__(self, index: int) -> RldsEpisode:
        """Return an episode by its index."""
        return RldsEpisode(self, range(self._count)[index])

    @functools.cached_property
    def outlines(self) -> list[Outline]:
        """The outline of each episode, read without decoding images."""
        steps = self._builder.info.features[_STEPS].feature
        skipped = _skip_images(steps, self._tfds)
        decoders = {_STEPS: skipped} if skipped else None
        return [self._outline(episode) for episode in self._episodes(0, decoders)]

    def steps(self, index: int) -> list[dict[str, Any]]:
        """Return the steps of an episode as maps from feature path to value; the last episode is cached."""
        if self._read[0] != index:
            self._read = -1, []  # only one at a time is in memory
            at, episodes = self._next or (0, None)
            if episodes is None or not at <= index < at + _AHEAD:
                at, episodes = index, self._episodes(index)
            for _ in range(at, index):  # skipped episodes are not decoded
                next(episodes)
            self._next = None
            episode = next(episodes)
            self._read = index, [dict(_flat(step, "")) for step in episode[_STEPS]]
            self._next = index + 1, episodes
        return self._read[1]

    def _episodes(self, first: int, decoders: object = None) -> Iterator[Any]:
        """Yield the episodes from `first` on, in order: files are read one after the other."""
        if first >= self._count:
            return iter(())
        one_by_one = self._tfds.ReadConfig(interleave_cycle_length=1)
        split = f"{_SPLIT}[{first}:]"
        dataset = self._builder.as_dataset(split=split, decoders=decoders, read_config=one_by_one, shuffle_files=False)
        return iter(self._tfds.as_numpy(dataset))

    def _outline(self, episode: Mapping[str, Any]) -> Outline:
        length = 0
        first: dict[str, Any] = {}
        for step in episode[_STEPS]:
            first = first or dict(_flat(step, ""))
            length += 1
        sizes = dict(_images(self._builder.info.features[_STEPS].feature, "", self._tfds))
        cameras = {name: _camera(sizes[name], value) for name, value in first.items() if name in sizes}
        columns = {
            name: ColumnInfo(tuple(np.shape(value)), np.asarray(value).dtype.name)
            for name, value in first.items()
            if name not in sizes and np.asarray(value).dtype.kind in "biuf"
        }
        rest = {name: value for name, value in episode.items() if name != _STEPS}
        extras = {name: _plain(value) for name, value in _flat(rest, "") if np.size(value) <= _MOST_FACT}
        return Outline(length, _sentences(first), columns, cameras, extras)


class RldsEpisode(OutlinedEpisode):
    """An episode; all its steps are read together on first access."""

    def __init__(self, owner: RldsSet, index: int) -> None:
        super().__init__(f"episode_{index:06d}")
        self._owner, self._index = owner, index

    def read(self, column: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Return rows of a column."""
        info = self.columns[column]
        rows = [np.asarray(step[column]) for step in self._owner.steps(self._index)[start:stop]]
        return np.stack(rows) if rows else np.empty((0, *info.shape), info.dtype)

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        if camera not in self.cameras:
            raise KeyError(camera)
        for step in self._owner.steps(self._index)[start:stop]:
            yield np.asarray(step[camera])

    def outline(self) -> Outline:
        """Read everything but rows and images."""
        return self._owner.outlines[self._index]


def _images(features: Any, prefix: str, tfds: ModuleType) -> Iterator[tuple[str, tuple[int | None, ...]]]:
    """Yield the path and declared shape of each colour image among the features."""
    for name, feature in features.items():
        if isinstance(feature, tfds.features.FeaturesDict):
            yield from _images(feature, f"{prefix}{name}/", tfds)
        elif len(feature.shape) == 3 and feature.shape[2] == 3 and np.dtype(feature.np_dtype) == np.uint8:
            yield prefix + name, feature.shape


def _skip_images(features: Any, tfds: ModuleType) -> dict[str, Any]:
    """Return the decoders that read features without decoding images."""
    decoders: dict[str, Any] = {}
    for name, feature in features.items():
        if isinstance(feature, tfds.features.FeaturesDict):
            inner = _skip_images(feature, tfds)
            decoders |= {name: inner} if inner else {}
        elif isinstance(feature, tfds.features.Image):
            decoders[name] = tfds.decode.SkipDecoding()
    return decoders


def _camera(shape: tuple[int | None, ...], value: Any) -> CameraInfo:
    """Return a camera by its declared shape, or by its first image, encoded or not."""
    is_encoded = isinstance(value, bytes)
    width, height = (shape[1], shape[0]) if None not in shape else size_of(value) if is_encoded else value.shape[1::-1]
    if not width or not height or width * height > PIXELS:
        raise DataError(f"images of {height} x {width} are not read: more than {PIXELS} pixels, or none")
    begins = {b"\xff\xd8": "jpeg", b"\x89P": "png"}
    return CameraInfo(int(height), int(width), encoding=begins.get(value[:2], "raw") if is_encoded else "raw")


def _sentences(first: Mapping[str, Any]) -> tuple[str, ...]:
    values = [first.get(prefix + name) for name in _SENTENCES for prefix in ("", "observation/")]
    texts = [value.decode("utf-8", "replace") for value in values if isinstance(value, bytes)]
    return tuple(dict.fromkeys(text for text in texts if text.strip()))


def _plain(value: object) -> Any:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _flat(value: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, item in value.items():
        if isinstance(item, Mapping):
            yield from _flat(item, f"{prefix}{name}/")
        else:
            yield prefix + name, item
