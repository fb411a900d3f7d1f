"""Traversal and change of the arrays, tensors and texts that an adapter's `encode` returns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Callable

import numpy as np

from xpl.contract import Observation
from xpl.wire.arrays import ArrayError, as_array

LeafChange = Callable[[Any], Any]
"""Returns the replacement of a leaf."""
EncodeOne = Callable[[Observation], Any]
"""An adapter's `encode`, of one environment."""

_DEEPEST = 6
_LEAST = 12
"""Least number of pixels of a side of an image."""


class NoEffectError(ValueError):
    """A change does not apply to the inputs of this adapter's model."""


def leaves(value: object, depth: int = _DEEPEST) -> Iterator[Any]:
    """Yield the arrays and texts of a value in order, arrays as numpy arrays."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values() if depth else ():
            yield from leaves(item, depth - 1)
    elif isinstance(value, (list, tuple)) and not _is_vector(value):
        for item in value if depth else ():
            yield from leaves(item, depth - 1)
    else:
        array = _array(value)
        if array is not None:
            yield array


def map_leaves(value: object, change: LeafChange, depth: int = _DEEPEST) -> Any:
    """Return a value with its arrays and texts changed.

    Args:
        value: arrays, tensors, texts, and maps and lists of these.
        change: returns the replacement of an array or a text; None keeps it.
        depth: levels of maps and lists that are traversed.
    """
    if isinstance(value, str):
        result = change(value)
        return value if result is None else result
    if isinstance(value, Mapping):
        return {key: map_leaves(item, change, depth - 1) if depth else item for key, item in value.items()}
    if isinstance(value, (list, tuple)) and not _is_vector(value):
        items = [map_leaves(item, change, depth - 1) if depth else item for item in value]
        return type(value)(*items) if hasattr(value, "_fields") else type(value)(items)
    array = _array(value)
    result = None if array is None else change(array)
    return value if result is None else _like(value, result)


def _is_vector(value: Any) -> bool:
    return bool(value) and all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in value)


def _array(value: object) -> Any:
    """Return an array of an array, a tensor or a list of numbers, or None."""
    if isinstance(value, (list, tuple)):
        return np.asarray(value, np.float64)
    if not hasattr(value, "shape") or not hasattr(value, "ndim"):
        return None
    try:
        return as_array(value)
    except ArrayError:
        return None


def _like(value: object, array: np.ndarray) -> Any:
    """Return an array in the type of `value`: a tensor of the same device, an array, a list."""
    if isinstance(value, np.ndarray):
        return array if value.dtype.kind != "f" else array.astype(value.dtype, copy=False)
    if hasattr(value, "new_tensor"):
        return value.new_tensor(array)
    return type(value)(array.tolist()) if isinstance(value, (list, tuple)) else array


def channel_axis(array: Any) -> int | None:
    """Return the channel axis of an image, or of several in one array; None for anything else."""
    if isinstance(array, str) or array.ndim < 3:
        return None
    height, width, last = array.shape[-3:]
    if last == 3 and min(height, width) >= _LEAST:
        return -1
    return -3 if height == 3 and min(width, last) >= _LEAST else None


def is_vector(leaf: Any) -> bool:
    """Return whether an input array holds a state vector."""
    return not isinstance(leaf, str) and leaf.dtype.kind == "f" and leaf.ndim in (1, 2) and leaf.shape[-1] > 3


def map_images(value: Any, change: Callable[[Any, int], Any]) -> Any:
    """Return model inputs with their images changed.

    Args:
        value: encoded inputs.
        change: returns the replacement of (image, channel axis); None keeps it.
    """

    def changed_one(array: Any) -> Any:
        axis = channel_axis(array)
        return None if axis is None else change(array, axis)

    return map_leaves(value, changed_one)


def map_vectors(value: Any, width: int, change: Callable[[Any], Any]) -> Any:
    """Return model inputs or outputs with the vectors of a width changed.

    Args:
        value: arrays, tensors, texts, and maps and lists of these; images and texts stay.
        width: length of the last axis of the arrays that are changed.
        change: returns the replacement of an array (..., width).

    Raises:
        NoEffectError: no array has this width.
    """
    is_found = False

    def changed_one(leaf: Any) -> Any:
        nonlocal is_found
        if channel_axis(leaf) is not None or isinstance(leaf, str) or leaf.ndim < 1 or leaf.shape[-1] != width:
            return None
        is_found = True
        return change(leaf)

    result = map_leaves(value, changed_one)
    if not is_found:
        raise NoEffectError("no vector of this width")
    return result
