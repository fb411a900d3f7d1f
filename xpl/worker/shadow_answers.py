"""Answers of shadow mode in place of a model: a fixed function of the model inputs.

The function makes mistakes visible in its answers:

- every number and text has an effect, however small the change: a hash of them moves each value a little;
- it is smooth: averages over the parts of an array move the values a lot, so that a compressed image gives nearly the
  same actions, and one with red and blue exchanged does not;
- NaN in the inputs gives NaN, as in a model.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np

from xpl.wire.arrays import ArrayError, as_array, data_of
from xpl.worker.missing_requirements import ShadowError

_PARTS = 12  # of an array that are averaged; a multiple of the channels that images have, 3 and 4
_DEPTH = 32
_SMOOTH, _HASH = 0.4, 1e-3  # shares of a value's range


class ShadowAnswers:
    """A function from model inputs to action chunks.

    Args:
        shape: (steps, width) of a chunk.
        low, high: smallest and largest value of each column, (D,) each.
    """

    def __init__(self, shape: tuple[int, int], low: np.ndarray, high: np.ndarray) -> None:
        self._shape, self._low, self._high = shape, low, high
        self._cached_weights: tuple[Any, np.ndarray] = ((), np.empty(0))

    def of(self, inputs: object) -> np.ndarray:
        """Return the chunk for inputs, (H, D) float32.

        Raises:
            ShadowError: they hold nothing that a model could read.
        """
        digest, layout, features = hashlib.sha256(), [], []
        for path, leaf in _leaves(inputs, "", 0):
            parts = _averages(leaf)
            digest.update(f"{path} {leaf.dtype.str} {leaf.shape} ".encode())
            digest.update(data_of(leaf))
            layout.append((path, len(parts)))
            features += parts
        if not features:
            raise ShadowError("encode returns nothing that a model could read")
        weights = self._weights(tuple(layout), len(features))
        noise = np.random.default_rng(int.from_bytes(digest.digest(), "little")).uniform(-1, 1, self._shape)
        smooth = np.tensordot(np.array(features), weights, 1) / np.sqrt(len(features))
        shares: np.ndarray = 0.5 + _SMOOTH * np.tanh(smooth) + _HASH * noise
        chunk: np.ndarray = (self._low + (self._high - self._low) * shares).astype(np.float32)
        return chunk

    def _weights(self, layout: tuple[Any, ...], count: int) -> np.ndarray:
        """Return the weights (count, H, D) of the features; cached, because a model's inputs keep their layout."""
        if self._cached_weights[0] != layout:
            seed = int.from_bytes(hashlib.sha256(repr(layout).encode()).digest(), "little")
            weights = np.random.default_rng(seed).standard_normal((count, *self._shape))
            self._cached_weights = (layout, weights)
        return self._cached_weights[1]


def _leaves(value: object, path: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield (path, array) of every array, number and text of a value."""
    if depth > _DEPTH:
        raise ShadowError(f"encode returns a value that is nested more than {_DEPTH} deep, or holds itself")
    items = _items(value)
    if items is not None:
        for key, item in items:
            yield from _leaves(item, f"{path}/{key}", depth + 1)
    elif value is None:
        yield path, np.zeros(1, np.uint8)
    elif isinstance(value, (str, bytes)):
        data = value.encode(errors="surrogatepass") if isinstance(value, str) else value
        yield path, np.frombuffer(hashlib.sha256(data).digest(), np.uint8)
    else:
        yield path, _canonical(_array(value))


def _items(value: object) -> list[tuple[Any, Any]] | None:
    """Return the (key, item) pairs of a container in a fixed order; None for other values and lists of numbers."""
    if isinstance(value, Mapping):
        return [(repr(key), value[key]) for key in sorted(value, key=repr)]
    if isinstance(value, AbstractSet):
        return list(enumerate(sorted(value, key=repr)))
    if isinstance(value, (list, tuple)):
        return None if _are_numbers(value) else list(enumerate(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [(entry.name, getattr(value, entry.name)) for entry in dataclasses.fields(value)]
    return None


def _are_numbers(value: Sequence[Any]) -> bool:
    """Return whether a list can be converted to a numeric array."""
    if not value or not isinstance(value[0], (bool, int, float, list, tuple)):
        return False
    try:
        return np.array(value).dtype.kind in "biuf"
    except ValueError:  # ragged
        return False


def _array(value: object) -> np.ndarray:
    try:
        # Also objects with the array interface: images, arrays of other libraries.
        return as_array(value if hasattr(value, "detach") and not isinstance(value, type) else np.asarray(value))
    except (ArrayError, OverflowError):
        kind = f"{type(value).__module__}.{type(value).__qualname__}"
        raise ShadowError(
            f"encode returns a {kind}: shadow mode reads arrays, tensors, numbers, text, maps and lists"
        ) from None


def _canonical(array: np.ndarray) -> np.ndarray:
    """Return the array in one of few dtypes, so that equal numbers have equal bytes."""
    if array.dtype.kind == "f":
        array = array.astype("<f4")
    elif array.dtype.kind in "bu" and array.dtype.itemsize == 1:
        array = array.view(np.uint8)
    elif array.dtype.kind in "iu":
        array = array.astype("<i8")
    elif array.dtype.kind == "c":
        array = np.stack([array.real, array.imag]).astype("<f4")
    else:
        return np.frombuffer(hashlib.sha256(data_of(array)).digest(), np.uint8)
    return np.ascontiguousarray(array)


def _averages(leaf: np.ndarray) -> list[float]:
    """Return averages over parts of an array: every twelfth value (for channels), and twelfths."""
    flat = leaf.reshape(-1)
    if not flat.size:
        return [0.0]
    if flat.size <= _PARTS:
        parts: Sequence[np.ndarray] = [flat[index : index + 1] for index in range(flat.size)]
    else:
        parts = [*(flat[first::_PARTS] for first in range(_PARTS)), *np.array_split(flat, _PARTS)]
    means = [float(part.mean(dtype=np.float64)) for part in parts]
    if leaf.dtype == np.uint8:
        return [mean / 128.0 - 1.0 for mean in means]
    return [float(np.arcsinh(mean)) if np.isfinite(mean) else np.nan for mean in means]
