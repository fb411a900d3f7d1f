"""What tests of several formats share: messages of our own making, comparison to the bit, and what reading costs."""

from __future__ import annotations

import json
import struct
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np


def framed(tree: Any, body: bytes = b"") -> bytes:
    """Return a message that our encoders would not write: a header, as JSON or as it is, and a body."""
    text = tree if isinstance(tree, bytes) else json.dumps(tree).encode()
    text += b" " * (-len(text) % 16)
    return struct.pack("<4sIQ", b"XPL1", len(text), len(body)) + text + body


def same(one: Any, other: Any) -> bool:
    """Tell whether two values are equal in types, shapes and bits; NaN is equal to itself."""
    if isinstance(one, (np.ndarray, np.generic)):
        alike = type(one) is type(other) and (one.dtype, one.shape) == (other.dtype, other.shape)
        return alike and one.tobytes() == other.tobytes()
    if isinstance(one, dict):
        return isinstance(other, dict) and list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and (one == other or (one != one and other != other))  # noqa: PLR0124 - NaN


def looped() -> list[Any]:
    """Return a list that contains itself."""
    loop: list[Any] = []
    loop.append(loop)
    return loop


def peak(action: Callable[[], object]) -> int:
    """Return the most bytes that an action holds at a time."""
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
