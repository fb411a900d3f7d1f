"""Cache of arrays that both sides of a link have, so that they are not sent back.

A loop receives an observation and passes it to the policy. Its images were sent to the loop's process once; on the way
back a reference (value number, array index) replaces each array that the loop passes on unchanged. Arrays that the loop
made are sent. Both sides number alike: the arrays of a value in the order of traversal.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.wire.packed import PackingError

_CACHED_VALUES = 4
"""Number of cached values: loops keep a few observations as history."""


class SharedArrays:
    """The arrays of the last values that were sent."""

    def __init__(self) -> None:
        self._values: deque[tuple[int, list[np.ndarray]]] = deque(maxlen=_CACHED_VALUES)
        self._count = 0

    def add(self, value: object) -> None:
        """Cache the arrays of a value that was sent."""
        arrays = list(_arrays(value))
        if arrays:
            self._count += 1
            self._values.append((self._count, arrays))

    def reference_to(self, array: np.ndarray) -> tuple[int, int] | None:
        """Return (value number, array index) of an array; None if it is not cached."""
        if array.flags.writeable:  # its content may have changed
            return None
        for number, arrays in self._values:
            for index, cached in enumerate(arrays):
                if cached is array:
                    return number, index
        return None

    def resolve(self, number: Any, index: Any, dtype: np.dtype[np.generic], shape: Any) -> np.ndarray:
        """Return the array of a reference, as the peer sent it.

        Args:
            number: number of the cached value, from 1.
            index: index of the array in it, from 0.
            dtype: dtype that the array must have.
            shape: shape that the array must have, a list of sizes.

        Raises:
            PackingError: no such array is cached.
        """
        arrays = next((arrays for cached, arrays in self._values if cached == number), [])
        if type(index) is int and 0 <= index < len(arrays):
            array = arrays[index]
            if array.dtype == dtype and list(array.shape) == list(shape):
                return array
        raise PackingError("a reference to an array that is not cached")


def _arrays(value: object) -> Iterator[np.ndarray]:
    """Yield the large arrays in a value."""
    if isinstance(value, np.ndarray):
        if value.nbytes >= spec.LIMITS["shared_array"]:
            yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _arrays(item)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _arrays(item)
