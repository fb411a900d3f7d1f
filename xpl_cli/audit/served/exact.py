"""Where two answers differ, bit for bit: the place, both values, and how far they are apart."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

_NUMBERS = "biufc"


@dataclass(frozen=True)
class Mismatch:
    """The first place where two values differ.

    Attributes:
        path: keys and positions that lead there; the last ones are the element of an array.
        first, second: the two values there, or what they are where that differs already.
        size: distance of two numbers, or None where it makes no sense.
    """

    path: tuple[str | int, ...]
    first: Any
    second: Any
    size: float | None = None

    def __str__(self) -> str:
        apart = "" if self.size is None else f" (apart by {self.size:.3g})"
        return f"{self.first} against {self.second}{apart}"


def mismatch(first: Any, second: Any, tolerance: float = 0.0) -> Mismatch | None:
    """Return the first place where two answers differ, or None.

    Args:
        first: the one answer: maps, lists, text, numbers, numpy arrays and scalars.
        second: the other.
        tolerance: numbers may be apart by this much, and then may have different types, too; 0 compares bits, so that
            nan equals nan, and 0.0 is not -0.0.
    """
    return _compare((), first, second, tolerance)


def _compare(path: tuple[str | int, ...], first: Any, second: Any, tolerance: float) -> Mismatch | None:
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        if first.keys() != second.keys():
            return Mismatch(path, f"keys {', '.join(map(str, first))}", f"keys {', '.join(map(str, second))}")
        entries = ((key, first[key], second[key]) for key in first)
    elif isinstance(first, (list, tuple)) and isinstance(second, (list, tuple)):
        if len(first) != len(second):
            return Mismatch(path, _counted(first), _counted(second))
        entries = ((place, a, b) for place, (a, b) in enumerate(zip(first, second, strict=True)))
    elif _is_array(first) and _is_array(second):
        return _arrays(path, first, second, tolerance)
    else:
        return _scalars(path, first, second, tolerance)
    found = (_compare((*path, key), a, b, tolerance) for key, a, b in entries)
    return next((one for one in found if one is not None), None)


def _arrays(path: tuple[str | int, ...], first: Any, second: Any, tolerance: float) -> Mismatch | None:
    a, b = np.asarray(first), np.asarray(second)
    loose = tolerance > 0 and a.dtype.kind in _NUMBERS and b.dtype.kind in _NUMBERS
    if a.shape != b.shape or (a.dtype != b.dtype and not loose):
        return Mismatch(path, f"{a.dtype} {a.shape}", f"{b.dtype} {b.shape}")
    if a.size == 0 or a.tobytes() == b.tobytes():
        return None
    if loose:
        with np.errstate(invalid="ignore"):
            wide = np.complex128 if "c" in a.dtype.kind + b.dtype.kind else np.float64
            x, y = a.astype(wide), b.astype(wide)
            equal = (x == y) | (np.abs(x - y) <= tolerance) | (np.isnan(x) & np.isnan(y))
    else:
        rows = [np.frombuffer(value.tobytes(), np.uint8).reshape(value.size, -1) for value in (a, b)]
        equal = (rows[0] == rows[1]).all(axis=1).reshape(a.shape)
    if equal.all():
        return None
    place = tuple(int(index) for index in np.unravel_index(int(np.argmin(equal)), a.shape))
    x, y = a[place], b[place]
    return Mismatch((*path, *place), _shown(x), _shown(y), _distance(x, y))


def _scalars(path: tuple[str | int, ...], first: Any, second: Any, tolerance: float) -> Mismatch | None:
    size = _distance(first, second)
    if size is not None and tolerance > 0:
        equal = size <= tolerance or (first != first and second != second)  # noqa: PLR0124 - both are nan
    elif type(first) is float and type(second) is float:
        equal = struct.pack("<d", first) == struct.pack("<d", second)
    else:
        equal = type(first) is type(second) and bool(first == second)
    return None if equal else Mismatch(path, _shown(first), _shown(second), size)


def _distance(first: Any, second: Any) -> float | None:
    """Return how far two numbers are apart, or None if one of them is no number, or not finite."""
    for value in (first, second):
        number = isinstance(value, (int, float, complex, np.number, np.bool_))
        if not number:
            return None
    size = float(abs(complex(first) - complex(second)))
    return size if math.isfinite(size) else None


def _is_array(value: Any) -> bool:
    return isinstance(value, (np.ndarray, np.generic))


def _counted(values: Any) -> str:
    return "1 entry" if len(values) == 1 else f"{len(values)} entries"


def _shown(value: Any) -> Any:
    """Return a value as reports show it: a number of plain Python, or text of at most 80 characters."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value
    if isinstance(value, np.ndarray):
        return f"an array, {value.dtype} {value.shape}"
    if isinstance(value, (list, tuple)):
        return f"a list of {_counted(value)}"
    text = "".join(itertools.islice(value if isinstance(value, str) else repr(value), 81))
    return text if len(text) <= 80 else text[:77] + "..."
