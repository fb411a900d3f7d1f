"""Images of the standard as a model's image input, and back.

Source: spec/v1/model_io.schema.json, `images`. Geometry first, on RGB; then colours, numbers, axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.convert.errors import ConversionError
from xpl.convert.resample import resize
from xpl.observation import get_image

if TYPE_CHECKING:
    from xpl.contract import Entry, Observation

_BYTES = 255.0


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
        self._steps = [next(iter(step.items())) for step in entry.get("steps", ())]
        self._stack = entry.get("stack")
        self._is_bgr = entry["channels"] == "bgr"
        self._is_chw = entry["layout"] == "chw"
        self.is_bytes = entry["dtype"] == "uint8"
        self._low, self._high = entry.get("range", (0.0, 1.0))
        self._scale = np.float32((self._high - self._low) / _BYTES)
        self._mean = np.asarray(entry.get("mean", 0.0), np.float32)
        self._std = np.asarray(entry.get("std", 1.0), np.float32)
        where = f"model_io.images {self.name}"
        if len(self.cameras) > 1 and self._stack is None:
            raise ConversionError(
                f"{where}: shows {len(self.cameras)} cameras as one input; say stack: views, width or channels"
            )
        if self.is_bytes and not {"range", "mean", "std"}.isdisjoint(entry):
            raise ConversionError(
                f"{where}: bytes have neither range nor mean and std; say dtype: float32, or leave them out"
            )
        if self._low == self._high:
            raise ConversionError(f"{where}: range is {self._low} at both ends; say what 0 and 255 become")
        if (self._std == 0).any():
            raise ConversionError(f"{where}: std holds a zero, and images are divided by it; give each channel's own")

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
        for kind, how in self._steps:
            values = _STEPS[kind](values, how)
        if self._is_bgr:
            values = values[..., ::-1]
        values = self._numbers(values)
        return np.ascontiguousarray(np.moveaxis(values, -1, -3) if self._is_chw else values)

    @property
    def scaling(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """How bytes become numbers: scale, low, mean and std, float32, each to be broadcast over the whole input.

        `(bytes * scale + low - mean) / std`; the bytes are what `encode` makes where `dtype` is uint8.
        """
        scale, low = np.asarray(self._scale), np.asarray(self._low, np.float32)
        return scale, low, self._spread(self._mean), self._spread(self._std)

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
        values = np.moveaxis(view, -3, -1) if self._is_chw else view
        if not self.is_bytes:
            values = (values * self._std + self._mean - self._low) * (_BYTES / (self._high - self._low))
            values = np.clip(np.floor(values + 0.5), 0, _BYTES).astype(np.uint8)
        return np.ascontiguousarray(values[..., ::-1] if self._is_bgr else values)

    def _unview(self, view: np.ndarray, height: int, width: int) -> np.ndarray:
        values = self._picture(view)
        shapes = [(height, width)]
        for kind, how in self._steps:
            shapes.append(shape_after(kind, how, shapes[-1]))
        for (kind, how), before in reversed(list(zip(self._steps, shapes))):
            values = _UNDO[kind](values, how, before)
        return np.ascontiguousarray(values)

    def _numbers(self, values: np.ndarray) -> np.ndarray:
        if self.is_bytes:
            return values if values.dtype == np.uint8 else np.clip(np.floor(values + 0.5), 0, _BYTES).astype(np.uint8)
        result: np.ndarray = (values * self._scale + np.float32(self._low) - self._mean) / self._std
        return result.astype(np.float32, copy=False)


def shape_after(kind: str, how: Any, shape: tuple[int, int]) -> tuple[int, int]:
    """Return height and width after one step."""
    if kind in ("resize", "letterbox"):
        return int(how["to"][0]), int(how["to"][1])
    if kind == "crop":
        return _cropped(how, shape)
    return (shape[1], shape[0]) if kind == "rotate" and (how // 90) % 2 else shape


def _cropped(how: Entry, shape: tuple[int, int]) -> tuple[int, int]:
    if "to" in how:
        height, width = how["to"]
    else:
        height, width = (int(size * how["fraction"]) for size in shape)
    if height > shape[0] or width > shape[1]:
        raise ConversionError(
            f"a crop to {height}x{width} of an image of {shape[0]}x{shape[1]}; crop less, or resize it before"
        )
    if not (height and width):
        raise ConversionError(f"a crop leaves nothing of an image of {shape[0]}x{shape[1]}; say a larger fraction")
    return int(height), int(width)


def _resized(values: np.ndarray, how: Entry) -> np.ndarray:
    return _resampled(values, how, *how["to"])


def _resampled(values: np.ndarray, how: Entry, height: int, width: int) -> np.ndarray:
    as_bytes = how.get("as", "uint8") == "uint8"
    return resize(values, (height, width), how["filter"], antialias=how.get("antialias", False), as_bytes=as_bytes)


def _letterboxed(values: np.ndarray, how: Entry) -> np.ndarray:
    height, width = how["to"]
    rows, columns, top, left = _frame(values.shape[:2], how)
    frame = np.full((height, width, values.shape[2]), how.get("fill", 0), np.float32)
    inside = _resampled(values, how, rows, columns)
    frame[top : top + rows, left : left + columns] = inside
    return frame.astype(inside.dtype)


def _frame(shape: tuple[int, ...], how: Entry) -> tuple[int, int, int, int]:
    """Return height, width, first row and first column of the image in its frame."""
    (height, width), anchor = how["to"], how.get("anchor", "center")
    # As written by the authors: multiplied by the inverse, one pixel is lost for other sizes than for them.
    ratio = max(shape[1] / width, shape[0] / height)
    rows, columns = int(shape[0] / ratio), int(shape[1] / ratio)
    if not (rows and columns):
        raise ConversionError(f"nothing is left of an image of {shape[0]}x{shape[1]} in a frame of {height}x{width}")
    free = height - rows, width - columns
    if anchor == "center":
        return rows, columns, free[0] // 2, free[1] // 2
    return (rows, columns, *free) if anchor == "bottom_right" else (rows, columns, 0, 0)


def _crop(values: np.ndarray, how: Entry) -> np.ndarray:
    height, width = _cropped(how, values.shape[:2])
    top, left = (values.shape[0] - height) // 2, (values.shape[1] - width) // 2
    return values[top : top + height, left : left + width]


def _rotated(values: np.ndarray, how: int) -> np.ndarray:
    return np.rot90(values, how // 90)


def _mirrored(values: np.ndarray, how: str) -> np.ndarray:
    return values[:, ::-1] if how == "left_right" else values[::-1]


def _uncropped(values: np.ndarray, _how: object, before: tuple[int, int]) -> np.ndarray:
    result = np.zeros((*before, values.shape[2]), values.dtype)
    top, left = (before[0] - values.shape[0]) // 2, (before[1] - values.shape[1]) // 2
    result[top : top + values.shape[0], left : left + values.shape[1]] = values
    return result


def _unboxed(values: np.ndarray, how: Entry, before: tuple[int, int]) -> np.ndarray:
    rows, columns, top, left = _frame(before, how)
    return _resampled(values[top : top + rows, left : left + columns], {**how, "as": "uint8"}, *before)


_STEPS: dict[str, Callable[[np.ndarray, Any], np.ndarray]] = {
    "resize": _resized,
    "letterbox": _letterboxed,
    "crop": _crop,
    "rotate": _rotated,
    "mirror": _mirrored,
}
_UNDO: dict[str, Callable[[np.ndarray, Any, tuple[int, int]], np.ndarray]] = {
    "resize": lambda values, how, before: _resampled(values, {**how, "as": "uint8"}, *before),
    "letterbox": _unboxed,
    "crop": _uncropped,
    "rotate": lambda values, how, _before: np.rot90(values, -how // 90),
    "mirror": lambda values, how, _before: _mirrored(values, how),
}
