"""Encoded vectors normalised by other statistics of the adapter's module or model."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.catalogue.walk import EncodeOne, LeafChange, NoEffectError, channel_axis, is_vector, leaves, map_leaves

if TYPE_CHECKING:
    from xpl.contract import Entry, Observation

_MOST_ARRAYS = 12
_NEAR = 1e-4
_EPSILON = 1e-6

Line = tuple[str, LeafChange, LeafChange]
"""A normalisation: description, function and inverse."""


class RenormalizedInputs:
    """Normalises vectors by other arrays of the adapter's module and model.

    Args:
        model: the adapter's model.
        encode: its `encode`.
        sample: an observation.
    """

    def __init__(self, model: Any, encode: EncodeOne, sample: Observation) -> None:
        widths = [leaf.shape[-1] for leaf in leaves(encode(sample)) if channel_axis(leaf) is None and is_vector(leaf)]
        self._width = widths[0] if len(set(widths)) == 1 else 0
        self._lines = list(lines(_arrays(model, self._width))) if self._width else []
        self._now = self._count_state_values(encode(sample), sample)

    def __len__(self) -> int:
        return len(self._lines)

    def change(self, value: object, how: Entry) -> tuple[Any, str]:
        """Return encoded inputs with vectors normalised by other statistics, and the description of the change.

        Raises:
            NoEffectError: there are no such statistics, or the adapter uses them already.
        """
        number = how["number"]
        if number >= len(self._lines) or self._now is None or number == self._now:
            raise NoEffectError("no such numbers")
        words, there, _ = self._lines[number]
        back = self._lines[self._now][2]

        def change(leaf: object) -> Any:
            return there(back(leaf)) if channel_axis(leaf) is None and is_vector(leaf) else None

        return map_leaves(value, change), f"normalize: {words}, not {self._lines[self._now][0]}"

    def _count_state_values(self, value: object, sample: Observation) -> int | None:
        """Return the index of the adapter's normalisation: its inverse gives most values of the state; None if none."""
        state = np.concatenate([np.ravel(item) for item in sample[spec.Obs.STATE].values() if _is_numbers(item)])
        vector = next((leaf for leaf in leaves(value) if channel_axis(leaf) is None and is_vector(leaf)), None)
        best: tuple[int, int | None] = (0, None)
        for number, (_, _, back) in enumerate(self._lines):
            raw = np.ravel(back(vector))
            known = int((np.abs(raw[:, None] - state[None]).min(1) < _NEAR * (1 + np.abs(raw))).sum())
            if known > best[0]:
                best = known, number
        return best[1] if best[0] * 2 >= self._width else None


def _is_numbers(item: object) -> bool:
    return not isinstance(item, Mapping) and np.asarray(item).dtype.kind == "f"


def lines(arrays: Mapping[str, Any]) -> Iterator[Line]:
    """Yield the normalisations by pairs of vectors; the first one changes nothing."""
    yield "none", _same, _same
    for (one, low), (other, high) in itertools.permutations(arrays.items(), 2):
        span = high - low
        if (span >= 0).all() and (span > 0).any():
            scale = span + _EPSILON
            yield f"{one} to {other} as -1 to 1", *_line(low + scale / 2, scale / 2)
            yield f"{one} to {other} as 0 to 1", *_line(low, scale)
        if (high > 0).all():
            yield f"mean {one}, std {other}", *_line(low, high)


def _same(value: object) -> Any:
    return value


def _line(shift: object, scale: object) -> tuple[LeafChange, LeafChange]:
    return lambda value: (value - shift) / scale, lambda value: value * scale + shift


def _arrays(model: Any, width: int) -> dict[str, np.ndarray]:
    """Return the vectors of a width in the adapter's module and model, by name."""
    module = sys.modules.get(type(model).__module__)
    return of_width([{**vars(module), **vars(model)} if module is not None else vars(model)], width, _MOST_ARRAYS)


def of_width(namespaces: Iterable[Mapping[Any, Any]], width: int, most: int) -> dict[str, np.ndarray]:
    """Return the vectors of a width in some namespaces, (width,) float64 each, by name.

    Args:
        namespaces: maps of attributes by name.
        width: length of a vector.
        most: most vectors to return; equal ones count once.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, value in itertools.chain(*map(named, namespaces)):
        try:
            array = np.asarray(value, np.float64)
        except (TypeError, ValueError):
            continue
        is_duplicate = any(np.array_equal(array, other) for other in arrays.values())
        if array.shape == (width,) and np.isfinite(array).all() and not is_duplicate and len(arrays) < most:
            arrays[name] = array
    return arrays


def named(namespace: Mapping[Any, Any], depth: int = 3) -> Iterator[tuple[str, Any]]:
    """Yield the lists, arrays and tensors of a namespace and its maps, by dotted name."""
    for name, value in list(namespace.items()):
        if not isinstance(name, str) or name.startswith("__"):
            continue
        if isinstance(value, Mapping) and depth:
            for inner, item in named(value, depth - 1):
                yield f"{name}.{inner}", item
        elif isinstance(value, (list, tuple, np.ndarray)) or hasattr(value, "new_tensor"):
            yield name, value
