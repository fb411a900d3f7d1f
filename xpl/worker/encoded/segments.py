"""Segments of encoded vectors that are a field of the state, normalised by other statistics of the package."""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.catalogue.walk import EncodeOne, NoEffectError, channel_axis, is_vector, leaves, map_leaves
from xpl.worker.encoded.vectors import lines, of_width

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.contract import Entry, Observation

_WIDTHS = range(3, 10)
"""Widths of a position, and of an arm's joints."""
_MOST_ARRAYS = 10
_NEAR = 1e-4
_ENDS = (-1.0, 0.0, 1.0)
"""Values at which normalised numbers are clipped."""


@dataclass(frozen=True)
class _Segment:
    """A segment of a vector.

    Attributes:
        start, width: its offset and length.
        line: index of its normalisation.
    """

    start: int
    width: int
    line: int


class RenormalizedSegments:
    """Normalises segments of vectors by other statistics.

    Args:
        model: the adapter's model.
        encode: its `encode`.
        samples: observations in which segments are identified.
    """

    def __init__(self, model: Any, encode: EncodeOne, samples: Sequence[Observation]) -> None:
        self._lines = {width: list(_turned(_arrays(model, width))) for width in _WIDTHS}
        self._segments: dict[int, list[_Segment]] = {}
        vectors = [[leaf for leaf in leaves(encode(one)) if _is_one(leaf)] for one in samples]
        for several in zip(*vectors):
            width = several[0].shape[-1]
            if width not in self._segments:
                rows = np.stack([np.ravel(one)[-width:] for one in several])
                self._segments[width] = list(self._parts(rows, [_fields(one) for one in samples]))
        used = [segment for segments in self._segments.values() for segment in segments]
        self._changes = list(dict.fromkeys((one.width, one.line) for one in used))

    def change(self, value: Any, how: Entry) -> tuple[Any, str]:
        """Return encoded inputs with segments normalised by other statistics, and the description of the change.

        Raises:
            NoEffectError: there are no such segments or statistics.
        """
        wanted = [
            (width, line, other)
            for width, line in self._changes
            for other in range(len(self._lines[width]))
            if other != line
        ]
        if how["number"] >= len(wanted):
            raise NoEffectError("no such numbers")
        width, line, other = wanted[how["number"]]
        words, there, _ = self._lines[width][other]
        was, _, back = self._lines[width][line]

        def change(leaf: Any) -> Any:
            if not _is_one(leaf):
                return None
            result = np.array(leaf, np.float64)
            for one in self._segments.get(leaf.shape[-1], ()):
                if (one.width, one.line) == (width, line):
                    part = slice(one.start, one.start + width)
                    result[..., part] = there(back(result[..., part]))
            return result

        return map_leaves(value, change), f"normalize: {words}, not {was}"

    def _parts(self, rows: np.ndarray, fields: Sequence[Mapping[str, np.ndarray]]) -> Iterator[_Segment]:
        """Yield the segments of a vector that are fields of the state under one of the normalisations."""
        for width in _WIDTHS:
            for start in range(rows.shape[1] - width + 1):
                part = rows[:, start : start + width]
                for number, (_, _, back) in enumerate(self._lines[width]):
                    free = ~np.isin(part, _ENDS)
                    if any(_are_near(back(part), held, free) for held in _field_values(fields, width)):
                        yield _Segment(start, width, number)
                        break


def _field_values(fields: Sequence[Mapping[str, np.ndarray]], width: int) -> Iterator[np.ndarray]:
    """Yield rows of fields of a width, and of positions, as they are and reversed."""
    for name in fields[0]:
        size = spec.POSITION_DIM if name.endswith("pose") else len(fields[0][name])
        if size == width:
            rows = np.stack([one[name][:size] for one in fields])
            yield rows
            yield rows[:, ::-1]


def _are_near(one: np.ndarray, other: np.ndarray, free: np.ndarray) -> bool:
    """Return whether values are equal, except those that may have been clipped."""
    near = np.abs(one - other) < _NEAR * (1 + np.abs(other))
    return bool(near[free].all() and 2 * free.sum() >= free.size)


def _fields(obs: Observation) -> dict[str, np.ndarray]:
    state = obs[spec.Obs.STATE]
    return {name: np.ravel(np.asarray(value, np.float64)) for name, value in state.items() if np.ndim(value) == 1}


def _is_one(leaf: object) -> bool:
    return channel_axis(leaf) is None and is_vector(leaf)


def _turned(arrays: Mapping[str, np.ndarray]) -> Iterator[Any]:
    """Yield the normalisations by these arrays, and by the reversed ones."""
    both = [arrays, {f"{name} reversed": values[::-1] for name, values in arrays.items()}]
    for place, line in enumerate(itertools.chain(*map(lines, both))):
        if place == 0 or line[0] != "none":
            yield line


def _arrays(model: Any, width: int) -> dict[str, np.ndarray]:
    """Return the vectors of a width in the modules of the adapter's package and in the model, by name."""
    own = type(model).__module__
    package = own.rpartition(".")[0]
    modules = [own, *(name for name in sorted(sys.modules) if package and name.startswith(f"{package}."))]
    namespaces = [vars(model), *(vars(sys.modules[name]) for name in modules if name in sys.modules)]
    return of_width(namespaces, width, _MOST_ARRAYS)
