"""Bitwise comparison of two answers: the first difference, both values, and their distance."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Mapping, Sized
from dataclasses import dataclass

import numpy as np

ReportedValue = int | float | str
"""A value as reports show it."""
_NUMBERS = (int, float, complex, np.number, np.bool_)


@dataclass(frozen=True)
class Mismatch:
    """The first difference of two values.

    Attributes:
        path: keys and positions that lead there; the last ones are the element of an array.
        first, second: the two values there, or their types or shapes if these differ.
        size: distance of two numbers, or None where it makes no sense.
    """

    path: tuple[str | int, ...]
    first: ReportedValue
    second: ReportedValue
    size: float | None = None


def mismatch(first: object, second: object) -> Mismatch | None:
    """Return the first bitwise difference of two answers, or None: nan equals nan, and 0.0 differs from -0.0.

    Args:
        first: the one answer: maps, lists, text, numbers, numpy arrays and scalars.
        second: the other.
    """
    return _compare((), first, second)


def _compare(path: tuple[str | int, ...], first: object, second: object) -> Mismatch | None:
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        if first.keys() != second.keys():
            return Mismatch(path, f"keys {', '.join(map(str, first))}", f"keys {', '.join(map(str, second))}")
        entries = ((key, first[key], second[key]) for key in first)
    elif isinstance(first, (list, tuple)) and isinstance(second, (list, tuple)):
        if len(first) != len(second):
            return Mismatch(path, _describe_length(first), _describe_length(second))
        entries = ((index, a, b) for index, (a, b) in enumerate(zip(first, second, strict=True)))
    elif _is_array(first) and _is_array(second):
        return _arrays(path, first, second)
    else:
        return _scalars(path, first, second)
    mismatches = (_compare((*path, key), a, b) for key, a, b in entries)
    return next((one for one in mismatches if one is not None), None)


def _arrays(path: tuple[str | int, ...], first: object, second: object) -> Mismatch | None:
    a, b = np.asarray(first), np.asarray(second)
    if a.shape != b.shape or a.dtype != b.dtype:
        return Mismatch(path, f"{a.dtype} {a.shape}", f"{b.dtype} {b.shape}")
    if a.size == 0 or a.tobytes() == b.tobytes():
        return None
    rows = [np.frombuffer(value.tobytes(), np.uint8).reshape(value.size, -1) for value in (a, b)]
    equal = (rows[0] == rows[1]).all(axis=1).reshape(a.shape)
    position = tuple(int(index) for index in np.unravel_index(int(np.argmin(equal)), a.shape))
    x, y = a[position], b[position]
    return Mismatch((*path, *position), _report_value(x), _report_value(y), _distance(x, y))


def _scalars(path: tuple[str | int, ...], first: object, second: object) -> Mismatch | None:
    if type(first) is float and type(second) is float:
        equal = struct.pack("<d", first) == struct.pack("<d", second)
    else:
        equal = type(first) is type(second) and bool(first == second)
    return None if equal else Mismatch(path, _report_value(first), _report_value(second), _distance(first, second))


def _distance(first: object, second: object) -> float | None:
    """Return the distance of two numbers, or None if one is not a finite number."""
    if not isinstance(first, _NUMBERS) or not isinstance(second, _NUMBERS):
        return None
    size = float(abs(complex(first) - complex(second)))
    return size if math.isfinite(size) else None


def _is_array(value: object) -> bool:
    return isinstance(value, (np.ndarray, np.generic))


def _describe_length(values: Sized) -> str:
    return "1 entry" if len(values) == 1 else f"{len(values)} entries"


def _report_value(value: object) -> ReportedValue:
    """Return a value as reports show it: a number of plain Python, or text of at most 80 characters."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value
    if isinstance(value, np.ndarray):
        return f"an array, {value.dtype} {value.shape}"
    if isinstance(value, (list, tuple)):
        return f"a list of {_describe_length(value)}"
    text = "".join(itertools.islice(value if isinstance(value, str) else repr(value), 81))
    return text if len(text) <= 80 else text[:77] + "..."
