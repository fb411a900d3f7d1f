"""Arrays that one side of a link has shown the other, so that they need not travel back.

A loop gets an observation, and hands it to the policy. The images in it went to the loop's process once; on the way
back a number stands for each that the loop passes on as it came. What it made itself travels. Both sides count what is
shown alike: the arrays of a value in the order in which the value is walked through.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.wire.packed import PackingError

_KEPT = 4
"""Values that are remembered: loops keep a few observations as history."""


class Shown:
    """The arrays of the last values that were shown."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, list[np.ndarray]]] = deque(maxlen=_KEPT)
        self._count = 0

    def add(self, value: object) -> None:
        """Take note of a value that was shown."""
        arrays = list(_arrays(value))
        if arrays:
            self._count += 1
            self._kept.append((self._count, arrays))

    def place(self, array: np.ndarray) -> tuple[int, int] | None:
        """Return the number of a value and the place of an array in it; None where it is none that was shown."""
        if array.flags.writeable:  # it may be another one by now
            return None
        for number, arrays in self._kept:
            for index, known in enumerate(arrays):
                if known is array:
                    return number, index
        return None

    def find(self, number: Any, index: Any, dtype: np.dtype[np.generic], shape: Any) -> np.ndarray:
        """Return the array at a place.

        Raises:
            PackingError: nothing like it was shown there.
        """
        arrays = next((arrays for known, arrays in self._kept if known == number), [])
        if type(index) is int and 0 <= index < len(arrays):
            found = arrays[index]
            if found.dtype == dtype and list(found.shape) == list(shape):
                return found
        raise PackingError("an array is named that was not shown lately")


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
