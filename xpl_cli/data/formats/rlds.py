"""RLDS, in which DROID and Open X-Embodiment lie: read through tensorflow-datasets, where that is installed.

Source: github.com/google-research/rlds: an episode is a nested dataset `steps`, each with `observation` and `action`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl.images import PIXELS
from xpl_cli.data.sets.errors import DataError
from xpl_cli.data.sets.interface import Camera, Column

if TYPE_CHECKING:
    from numpy.typing import NDArray

NAME: Final = "rlds"
_INFO: Final = "dataset_info.json"
_FEATURES: Final = "features.json"
_SENTENCES: Final = (
    "language_instruction",
    "natural_language_instruction",
    "language_instruction_2",
    "language_instruction_3",
)
_STEPS: Final = "steps"


def recognises(path: Path) -> bool:
    """Tell whether a folder is a set that tensorflow-datasets has prepared."""
    return (path / _INFO).is_file() and (path / _FEATURES).is_file()


class RldsSet:
    """A folder with `dataset_info.json`; its split `train`."""

    def __init__(self, path: Path) -> None:
        try:
            import tensorflow_datasets as tfds
        except ImportError as error:
            raise DataError(
                f"{path} is RLDS, which is read through tensorflow-datasets, and that cannot be imported: {error}",
                hint="pip install tensorflow-datasets tensorflow",
            ) from None
        self._path = path
        self._tfds = tfds
        self._builder = tfds.builder_from_directory(str(path))
        self._count = int(self._builder.info.splits["train"].num_examples)

    @property
    def path(self) -> str:
        """The folder."""
        return str(self._path)

    @property
    def format(self) -> str:
        """The name of its format."""
        return NAME

    @property
    def rate_hz(self) -> float | None:
        """Unknown: RLDS does not say it."""
        return None

    @property
    def robot(self) -> str | None:
        """Unknown: RLDS does not say it."""
        return None

    @property
    def extras(self) -> Mapping[str, Any]:
        """Its name there."""
        return {"name": self._builder.name}

    def __len__(self) -> int:
        """How many episodes there are."""
        return self._count

    def __getitem__(self, index: int) -> RldsEpisode:
        """Return an episode, by its place."""
        return RldsEpisode(self, range(self._count)[index])

    def loaded(self, index: int) -> list[dict[str, Any]]:
        """Return the steps of an episode, by paths of their features."""
        found = self._builder.as_dataset(split=f"train[{index}:{index + 1}]")
        (episode,) = self._tfds.as_numpy(found)
        return [dict(_flat(step, "")) for step in episode[_STEPS]]


class RldsEpisode:
    """An episode; it is read as a whole when something of it is asked for."""

    def __init__(self, owner: RldsSet, index: int) -> None:
        self._owner, self._index = owner, index

    @property
    def key(self) -> str:
        """Its name in the set."""
        return f"episode_{self._index:06d}"

    @property
    def length(self) -> int:
        """How many steps it has."""
        return len(self._steps)

    @functools.cached_property
    def instructions(self) -> tuple[str, ...]:
        """What the robot was told, in all wordings."""
        first = self._steps[0] if self._steps else {}
        found = [first.get(prefix + name) for name in _SENTENCES for prefix in ("", "observation/")]
        texts = [value.decode("utf-8", "replace") for value in found if isinstance(value, bytes)]
        return tuple(dict.fromkeys(text for text in texts if text.strip()))

    @functools.cached_property
    def columns(self) -> Mapping[str, Column]:
        """The columns of numbers."""
        first = self._steps[0] if self._steps else {}
        return {
            name: Column(tuple(np.shape(value)), np.asarray(value).dtype.name)
            for name, value in first.items()
            if name not in self.cameras and np.asarray(value).dtype.kind in "biuf"
        }

    @functools.cached_property
    def cameras(self) -> Mapping[str, Camera]:
        """The cameras."""
        found = {}
        for name, value in (self._steps[0] if self._steps else {}).items():
            image = np.asarray(value)
            if image.ndim == 3 and image.dtype == np.uint8 and image.shape[2] == 3 and image[..., 0].size <= PIXELS:
                found[name] = Camera(image.shape[0], image.shape[1])
        return found

    @property
    def extras(self) -> Mapping[str, Any]:
        """Nothing that is read."""
        return {}

    def read(self, column: str, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Return rows of a column."""
        known = self.columns[column]
        rows = [np.asarray(step[column]) for step in self._steps[start:stop]]
        return np.stack(rows) if rows else np.empty((0, *known.shape), known.dtype)

    def frames(self, camera: str, start: int = 0, stop: int | None = None) -> Iterator[NDArray[np.uint8]]:
        """Yield images of a camera."""
        if camera not in self.cameras:
            raise KeyError(camera)
        for step in self._steps[start:stop]:
            yield np.asarray(step[camera])

    @functools.cached_property
    def _steps(self) -> list[dict[str, Any]]:
        return self._owner.loaded(self._index)


def _flat(value: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, item in value.items():
        if isinstance(item, Mapping):
            yield from _flat(item, f"{prefix}{name}/")
        else:
            yield prefix + name, item
