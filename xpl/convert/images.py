"""Images of the standard as a model's image input, and back.

Source: spec/v1/model_io.schema.json, `images`. Geometry first, on RGB; then colours, numbers, axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl.catalogue import convention as catalogue
from xpl.catalogue.pictures import shape_after
from xpl.conventions.image_range import Pixels, as_bytes
from xpl.errors import ConversionError
from xpl.observation import get_image

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.contract import Entry, Observation

_OWN = frozenset(("input", "cameras", "stack", "steps", "layout", "dtype", "range", "mean", "std", "history"))
"""Keys of an image input that this module reads, or `Pixels`; each other is a convention's."""


class ImageInput:
    """One image input of a model.

    Args:
        entry: of `images` in the model_io block.

    Attributes:
        name: the model's name for it.
        cameras: the standard's cameras that it shows.
        is_bytes: its numbers are bytes; else float32.
    """

    def __init__(self, entry: Entry) -> None:
        self.name: str = entry["input"]
        self.cameras: tuple[str, ...] = tuple(entry["cameras"])
        self._steps = [
            (word, how, catalogue.found("steps", word)) for step in entry.get("steps", ()) for word, how in step.items()
        ]
        self._stages = [(how, catalogue.found("images", key)) for key, how in entry.items() if key not in _OWN]
        self._stack = entry.get("stack")
        self._is_chw = entry["layout"] == "chw"
        where = f"model_io.images {self.name}"
        if len(self.cameras) > 1 and self._stack is None:
            raise ConversionError(
                f"{where}: shows {len(self.cameras)} cameras as one input; say stack: views, width or channels"
            )
        self._pixels = Pixels(entry, where)
        self.is_bytes = self._pixels.is_bytes

    def encode(self, obs: Observation) -> np.ndarray:
        """Return what the model gets of one observation, without a batch axis.

        Raises:
            ObservationError: if a camera is missing or is no image.
        """
        views = [self._seen(obs, camera) for camera in self.cameras]
        if self._stack is None:
            return views[0]
        if len({view.shape for view in views}) > 1:
            sizes = ", ".join(f"{camera} {view.shape}" for camera, view in zip(self.cameras, views))
            raise ConversionError(
                f"model_io.images {self.name}: views of one input have one size, these are {sizes}; add a resize"
            )
        if self._stack == "views":
            return np.stack(views)
        channel, column = (0, 2) if self._is_chw else (2, 1)
        return np.concatenate(views, axis=channel if self._stack == "channels" else column)

    def _seen(self, obs: Observation, camera: str) -> np.ndarray:
        try:
            return self.view(get_image(obs, camera))
        except ConversionError as error:
            raise ConversionError(f"model_io.images {self.name}, {camera}: {error}") from None

    def view(self, image: np.ndarray) -> np.ndarray:
        """Return one camera's image, (H, W, 3) uint8 RGB, as the model gets it."""
        values = image
        for _, how, step in self._steps:
            values = step.encode(values, how)
        for how, stage in self._stages:
            values = stage.encode(values, how)
        values = self._pixels.encode(values)
        return np.ascontiguousarray(np.moveaxis(values, -1, -3) if self._is_chw else values)

    @property
    def scaling(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """How bytes become numbers: scale, low, mean and std, float32, each to be broadcast over the whole input.

        `(bytes * scale + low - mean) / std`; the bytes are what `encode` makes where `dtype` is uint8.
        """
        pixels = self._pixels
        return np.asarray(pixels.scale), np.asarray(pixels.low), self._spread(pixels.mean), self._spread(pixels.std)

    def _spread(self, values: np.ndarray) -> np.ndarray:
        if not values.ndim:
            return values
        several = np.tile(values, len(self.cameras)) if self._stack == "channels" else values
        return several[:, None, None] if self._is_chw else several

    def decode(self, value: np.ndarray, sizes: Mapping[str, tuple[int, int]]) -> dict[str, np.ndarray]:
        """Return the cameras' images, (H, W, 3) uint8 RGB, that would be shown to the model as `value`.

        What a crop cut off is black, and what a filter blurred stays so.

        Args:
            value: the model's input, without a batch axis.
            sizes: by camera, height and width of its images.
        """
        return {
            camera: self._unview(view, *sizes[camera]) for camera, view in zip(self.cameras, self._unstacked(value))
        }

    def pictures(self, value: np.ndarray) -> list[np.ndarray]:
        """Return what the model sees of each camera, (h, w, 3) uint8 RGB, if the block says what its numbers mean.

        Geometry stays as the model gets it; `decode` undoes that too.

        Args:
            value: the model's input, without a batch axis.
        """
        return [self._picture(view) for view in self._unstacked(value)]

    def views(self, value: np.ndarray) -> list[np.ndarray]:
        """Return the numbers of each camera, (h, w, 3) whatever the model's layout, as they are."""
        return [np.moveaxis(view, -3, -1) if self._is_chw else view for view in self._unstacked(value)]

    def _unstacked(self, value: np.ndarray) -> Sequence[np.ndarray]:
        if self._stack is None:
            return [value]
        if self._stack == "views":
            return list(value)
        channel, column = (0, 2) if self._is_chw else (2, 1)
        return np.split(value, len(self.cameras), axis=channel if self._stack == "channels" else column)

    def _picture(self, view: np.ndarray) -> np.ndarray:
        values = self._pixels.decode(np.moveaxis(view, -3, -1) if self._is_chw else view)
        for how, stage in reversed(self._stages):
            values = stage.decode(values, how)
        return np.ascontiguousarray(as_bytes(values))

    def _unview(self, view: np.ndarray, height: int, width: int) -> np.ndarray:
        values = self._picture(view)
        shapes = [(height, width)]
        for word, how, _ in self._steps:
            shapes.append(shape_after(word, how, shapes[-1]))
        for (_, how, step), before in reversed(list(zip(self._steps, shapes))):
            values = step.undo(values, how, before)
        return np.ascontiguousarray(values)
