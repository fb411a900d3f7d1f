"""Image resampling with numpy: each filter as weights of a few pixels along each axis.

The filters and their formulas are those of spec/v1/model_io.schema.json#/$defs/filter. Pixel centres lie at half
integers. Without antialias the edge pixel is repeated, as OpenCV and torch do; with it, and for lanczos, weights beyond
the edge are left out and the others scaled to a sum of one, as Pillow and TensorFlow do. Bytes with antialias are
Pillow's to the last bit: they go through its whole-number arithmetic (libImaging/Resample.c). All other results differ
from those of the libraries by one step of 256 at most.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

_CUBIC_SHARP, _CUBIC_SMOOTH = -0.75, -0.5
_LOBES = 3.0
_BITS = 22
"""Of the fraction of a weight in Pillow's whole-number arithmetic (PRECISION_BITS)."""


def resize(
    image: np.ndarray, size: tuple[int, int], kind: str, *, antialias: bool = False, as_bytes: bool = True
) -> np.ndarray:
    """Resize images.

    Args:
        image: (..., H, W, C) uint8, or float32 0..255.
        size: (height, width), pixels.
        kind: filter: nearest, area, bilinear, bicubic or lanczos.
        antialias: widen the filter if the image shrinks.
        as_bytes: round to integers and clip to 0..255, as libraries do with 8-bit images.

    Returns:
        (..., height, width, C), in the dtype of `image`; float32 without `as_bytes`.
    """
    values, axes = image, [(-2, size[1]), (-3, size[0])]
    if antialias and image.dtype == np.uint8 and kind in _SMOOTH and as_bytes:
        for axis, target in axes:  # rounded after each direction, columns first
            values = _resize_axis_bytes(values, axis, target, kind)
        return np.ascontiguousarray(values)
    for axis, target in reversed(axes):  # rows first are less work
        values = _resize_axis(values, axis, target, kind, antialias=antialias)
    if not as_bytes:
        return np.ascontiguousarray(values, np.float32)
    # OpenCV's mean of an area rounds halves to even numbers, but for that of two by two pixels.
    to_even = kind == "area" and image.shape[-3:-1] != (2 * size[0], 2 * size[1])
    whole = np.rint(values) if to_even else np.floor(values + np.float32(0.5))
    return np.clip(whole, 0, 255).astype(image.dtype)


def _resize_axis(values: np.ndarray, axis: int, size: int, kind: str, *, antialias: bool) -> np.ndarray:
    """Resize one axis; the result is float32 if it is interpolated."""
    if values.shape[axis] == size:
        return values
    index, weight = taps(values.shape[axis], size, kind, antialias=antialias)
    first = np.ascontiguousarray(np.moveaxis(values, axis, 0))  # whole lines are gathered many times faster than pixels
    lines = first.reshape(len(first), -1)
    total = np.take(lines, index[:, 0], 0)
    if kind != "nearest":
        total = total * weight[:, :1]
        part, gathered = np.empty_like(total), np.empty(total.shape, lines.dtype)
        for tap in range(1, index.shape[1]):
            np.take(lines, index[:, tap], 0, out=gathered, mode="clip")  # within bounds: no copy is made to check
            total += np.multiply(gathered, weight[:, tap, None], out=part)
    result: np.ndarray = np.moveaxis(total.reshape(size, *first.shape[1:]), 0, axis)
    return result


def _resize_axis_bytes(values: np.ndarray, axis: int, size: int, kind: str) -> np.ndarray:
    """Resize one axis of uint8 images as Pillow does with 8-bit images."""
    if values.shape[axis] == size:
        return values
    index, weight = _whole_taps(values.shape[axis], size, kind)
    first = np.ascontiguousarray(np.moveaxis(values, axis, 0))
    lines = first.reshape(len(first), -1)
    total = np.full((size, lines.shape[1]), 1 << (_BITS - 1), np.int32)
    part, gathered = np.empty_like(total), np.empty(total.shape, lines.dtype)
    for tap in range(index.shape[1]):
        np.take(lines, index[:, tap], 0, out=gathered, mode="clip")  # within bounds: no copy is made to check
        total += np.multiply(gathered, weight[:, tap, None], out=part)
    total >>= _BITS
    made = np.clip(total, 0, 255, out=total).astype(np.uint8)
    result: np.ndarray = np.moveaxis(made.reshape(size, *first.shape[1:]), 0, axis)
    return result


@lru_cache(maxsize=128)
def _whole_taps(before: int, after: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return source indices and weights of each new pixel, (after, taps) int64 and int32; a weight of 1 is 2 ** 22."""
    index, weight = _smooth_taps(before, after, kind, antialias=True)
    scaled = weight * (1 << _BITS)
    return index, np.trunc(scaled + np.copysign(0.5, scaled)).astype(np.int32)


@lru_cache(maxsize=128)
def taps(before: int, after: int, kind: str, *, antialias: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return source indices and weights of each new pixel along one axis.

    Args:
        before: size of the axis, pixels.
        after: new size of the axis, pixels.
        kind: filter: nearest, area, bilinear, bicubic or lanczos.
        antialias: widen the filter if the image shrinks.

    Returns:
        Indices (after, taps) int64 and weights (after, taps) float32, which add up to 1.
    """
    scale = before / after
    if kind == "nearest":
        # A cumulative sum, as in Pillow and OpenCV: its rounding decides between two pixels.
        nearest = np.cumsum(np.concatenate(([0.5 * scale], np.full(after - 1, scale)))).astype(np.int64)
        return np.minimum(nearest, before - 1)[:, None], np.ones((after, 1), np.float32)
    if kind == "area":
        return _overlaps(before, after)
    index, weight = _smooth_taps(before, after, kind, antialias=antialias)
    return index, weight.astype(np.float32)


def _smooth_taps(before: int, after: int, kind: str, *, antialias: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return source indices and weights (after, taps) float64 of a smooth filter."""
    scale = before / after
    weigh, support = _kernel(kind, antialias=antialias)
    widened = max(scale, 1.0) if antialias else 1.0
    centre = (np.arange(after) + 0.5) * scale
    first = np.floor(centre - support * widened + 0.5).astype(np.int64)
    count = int(np.ceil(2 * support * widened)) + 1
    index = first[:, None] + np.arange(count)
    weight = weigh((index + 0.5 - centre[:, None]) / widened)
    if antialias or kind == "lanczos":
        weight = np.where((index >= 0) & (index < before), weight, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    used = np.abs(weight).max(axis=0) > 0
    return np.clip(index[:, used], 0, before - 1), weight[:, used]


def _overlaps(before: int, after: int) -> tuple[np.ndarray, np.ndarray]:
    """Return source indices and weights by the overlap with each new pixel."""
    edges = np.arange(after + 1) * (before / after)
    first = np.floor(edges[:-1]).astype(np.int64)
    index = first[:, None] + np.arange(int(np.ceil(before / after)) + 1)
    overlap = np.minimum(index + 1, edges[1:, None]) - np.maximum(index, edges[:-1, None])
    weight = np.clip(overlap, 0.0, None)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.clip(index, 0, before - 1), weight.astype(np.float32)


_SMOOTH = ("bilinear", "bicubic", "lanczos")
"""Filters that antialias widens."""


def _kernel(kind: str, *, antialias: bool) -> tuple[Callable[[np.ndarray], np.ndarray], float]:
    """Return a filter's weight function of the distance in pixels, and its support."""
    if kind == "bilinear":
        return lambda x: np.clip(1.0 - np.abs(x), 0.0, None), 1.0
    if kind == "bicubic":
        a = _CUBIC_SMOOTH if antialias else _CUBIC_SHARP
        return lambda x: _cubic(np.abs(x), a), 2.0
    return lambda x: np.where(np.abs(x) < _LOBES, np.sinc(x) * np.sinc(x / _LOBES), 0.0), _LOBES


def _cubic(x: np.ndarray, a: float) -> np.ndarray:
    near = ((a + 2) * x - (a + 3)) * x * x + 1
    far = (((x - 5) * x + 8) * x - 4) * a
    result: np.ndarray = np.where(x < 1, near, np.where(x < 2, far, 0.0))
    return result
