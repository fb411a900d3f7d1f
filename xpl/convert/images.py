"""Images of the standard as an image input of a model, and back.

Source: spec/v1/model_io.schema.json, `images`. Geometry first, on RGB; then channels, range, axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl.catalogue import convention as catalogue
from xpl.catalogue.image_changes import shape_after
from xpl.conventions.image_range import PixelScaling, as_bytes
from xpl.errors import ConversionError
from xpl.observation import get_image

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.contract import Entry, Observation

_OWN = frozenset(("input", "cameras", "stack", "steps", "layout", "dtype", "range", "mean", "std", "history"))
"""Keys of an image input that this module or `PixelScaling` reads; any other belongs to a convention."""


class ImageInput:
    """One image input of a model.

    Args:
        entry: of `images` in the model_io block.

    Attributes:
        name: name of the input.
        cameras: the standard's cameras in it.
        is_bytes: whether it is uint8; otherwise float32.
    """

    def __init__(self, entry: Entry) -> None:
        self.name: str = entry["input"]
        self.cameras: tuple[str, ...] = tuple(entry["cameras"])
        self._steps = [
            (word, how, catalogue.lookup("steps", word))
            for step in entry.get("steps", ())
            for word, how in step.items()
        ]
        self._transforms = [(how, catalogue.lookup("images", key)) for key, how in entry.items() if key not in _OWN]
        self._stack = entry.get("stack")
        self._is_chw = entry["layout"] == "chw"
        where = f"model_io.images {self.name}"
        if len(self.cameras) > 1 and self._stack is None:
            raise ConversionError(
                f"{where}: has {len(self.cameras)} cameras in one input; set stack to views, width or channels"
            )
        self._pixels = PixelScaling(entry, where)
        self.is_bytes = self._pixels.is_bytes

    def encode(self, obs: Observation) -> np.ndarray:
        """Return the model input of one observation, without batch axis.

        Raises:
            ObservationError: a camera is missing, or no image.
        """
        views = [self._camera_view(obs, camera) for camera in self.cameras]
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

    def _camera_view(self, obs: Observation, camera: str) -> np.ndarray:
        try:
            return self.view(get_image(obs, camera))
        except ConversionError as error:
            raise ConversionError(f"model_io.images {self.name}, {camera}: {error}") from None

    def view(self, image: np.ndarray) -> np.ndarray:
        """Return the model input of one camera's image, (H, W, 3) uint8 RGB."""
        values = image
        for _, how, step in self._steps:
            values = step.encode(values, how)
        for how, stage in self._transforms:
            values = stage.encode(values, how)
        values = self._pixels.encode(values)
        return np.ascontiguousarray(np.moveaxis(values, -1, -3) if self._is_chw else values)

    @property
    def scaling(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Span, low, mean and std of the pixel scaling, float32, broadcastable to the whole input.

        `(bytes * span / 255 + low - mean) / std`; the bytes are what `encode` returns for `dtype: uint8`.
        """
        pixels = self._pixels
        return np.asarray(pixels.span), np.asarray(pixels.low), self._spread(pixels.mean), self._spread(pixels.std)

    def _spread(self, values: np.ndarray) -> np.ndarray:
        if not values.ndim:
            return values
        several = np.tile(values, len(self.cameras)) if self._stack == "channels" else values
        return several[:, None, None] if self._is_chw else several

    def decode(self, value: np.ndarray, sizes: Mapping[str, tuple[int, int]]) -> dict[str, np.ndarray]:
        """Return the cameras' images, (H, W, 3) uint8 RGB, of a model input; the inverse of `encode`.

        Cropped regions are black; blur of a filter is not undone.

        Args:
            value: the model input, without batch axis.
            sizes: (height, width) of the images, by camera.
        """
        return {
            camera: self._undo_view(view, *sizes[camera])
            for camera, view in zip(self.cameras, self._split_cameras(value))
        }

    def visible_images(self, value: np.ndarray) -> list[np.ndarray]:
        """Return each camera's image as the model sees it, (h, w, 3) uint8 RGB, before geometry is undone.

        `decode` also undoes the geometry.

        Args:
            value: the model input, without batch axis.
        """
        return [self._undo_pixels(view) for view in self._split_cameras(value)]

    def views(self, value: np.ndarray) -> list[np.ndarray]:
        """Return each camera's values unchanged, (h, w, 3) whatever the model's layout."""
        return [np.moveaxis(view, -3, -1) if self._is_chw else view for view in self._split_cameras(value)]

    def _split_cameras(self, value: np.ndarray) -> Sequence[np.ndarray]:
        if self._stack is None:
            return [value]
        if self._stack == "views":
            return list(value)
        channel, column = (0, 2) if self._is_chw else (2, 1)
        return np.split(value, len(self.cameras), axis=channel if self._stack == "channels" else column)

    def _undo_pixels(self, view: np.ndarray) -> np.ndarray:
        values = self._pixels.decode(np.moveaxis(view, -3, -1) if self._is_chw else view)
        for how, stage in reversed(self._transforms):
            values = stage.decode(values, how)
        return np.ascontiguousarray(as_bytes(values))

    def _undo_view(self, view: np.ndarray, height: int, width: int) -> np.ndarray:
        values = self._undo_pixels(view)
        shapes = [(height, width)]
        for word, how, _ in self._steps:
            shapes.append(shape_after(word, how, shapes[-1]))
        for (_, how, step), before in reversed(list(zip(self._steps, shapes))):
            values = step.undo(values, how, before)
        return np.ascontiguousarray(values)
