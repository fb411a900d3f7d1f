"""Changes of rotations at any offset of encoded vectors: four numbers of length one, or two unit vectors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl.catalogue.walk import NoEffectError, channel_axis, is_vector, leaves, map_leaves

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Entry

_NEAR = 1e-4
_QUATERNION, _VECTORS = 4, 6

Function = Callable[[np.ndarray], np.ndarray]


class RotatedInputs:
    """Changes the representation of rotations.

    Args:
        samples: encoded inputs of several observations, in which rotations are identified.
        how: `turn`, a key of `_TURNS`.

    Raises:
        NoEffectError: the vectors have no such rotation.
    """

    def __init__(self, samples: Sequence[Any], how: Entry) -> None:
        self._width, found, self._turn = _TURNS[how["turn"]]
        vectors: dict[int, list[np.ndarray]] = {}
        for sample in samples:
            for leaf in leaves(sample):
                if channel_axis(leaf) is None and is_vector(leaf):
                    vectors.setdefault(leaf.shape[-1], []).append(leaf.reshape(-1, leaf.shape[-1]).astype(np.float64))
        self._offsets = {width: self._find_offsets(np.concatenate(rows), found) for width, rows in vectors.items()}
        if not any(self._offsets.values()):
            raise NoEffectError("no such rotation")

    def __call__(self, value: Any) -> Any:
        """Return encoded inputs with rotations changed."""

        def change(leaf: Any) -> Any:
            if channel_axis(leaf) is not None or not is_vector(leaf):
                return None
            result = np.array(leaf, np.float64)
            for place in self._offsets.get(leaf.shape[-1], ()):
                part = slice(place, place + self._width)
                result[..., part] = self._turn(result[..., part])
            return result

        return map_leaves(value, change)

    def _find_offsets(self, rows: np.ndarray, is_one: Callable[[np.ndarray], bool]) -> list[int]:
        """Return the offsets of rotations."""
        places, place = [], 0
        while place + self._width <= rows.shape[1]:
            if is_one(rows[:, place : place + self._width]):
                places.append(place)
                place += self._width
            else:
                place += 1
        return places


def _is_unit(rows: np.ndarray) -> bool:
    moves = bool((np.ptp(rows, axis=0) > _NEAR).any()) or len(rows) == 1
    return moves and bool((np.abs((rows * rows).sum(-1) - 1) < _NEAR).all())


def _are_orthonormal(one: np.ndarray, other: np.ndarray) -> bool:
    return _is_unit(one) and _is_unit(other) and bool((np.abs((one * other).sum(-1)) < _NEAR).all())


def _are_vectors(rows: np.ndarray) -> bool:
    return _are_orthonormal(rows[:, :3], rows[:, 3:])


def _are_interleaved(rows: np.ndarray) -> bool:
    return _are_orthonormal(rows[:, 0::2], rows[:, 1::2])


def _matrix(values: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (..., 3, 3) whose first rows these are, one after the other."""
    one, other = values[..., :3], values[..., 3:]
    return np.stack((one, other, np.cross(one, other)), axis=-2)


def _transposed(values: np.ndarray) -> np.ndarray:
    columns = np.swapaxes(_matrix(values), -1, -2)[..., :2, :]
    return np.asarray(columns.reshape(values.shape))


def _interleaved(values: np.ndarray) -> np.ndarray:
    return np.asarray(_matrix(values)[..., :, :2].reshape(values.shape))


def _apart(values: np.ndarray) -> np.ndarray:
    """Return the first two rows of the matrix whose first two columns are interleaved."""
    columns = np.concatenate((values[..., 0::2], values[..., 1::2]), axis=-1)
    return _transposed(columns)


def _signed(index: int) -> Function:
    return lambda values: np.where(values[..., [index]] < 0, -values, values)


def _rolled(by: int) -> Function:
    return lambda values: np.roll(values, by, axis=-1)


_TURNS: dict[str, tuple[int, Callable[[np.ndarray], bool], Function]] = {
    "transposed": (_VECTORS, _are_vectors, _transposed),
    "interleaved": (_VECTORS, _are_vectors, _interleaved),
    "apart": (_VECTORS, _are_interleaved, _apart),
    "last_first": (_QUATERNION, _is_unit, _rolled(1)),
    "first_last": (_QUATERNION, _is_unit, _rolled(-1)),
    "positive_first": (_QUATERNION, _is_unit, _signed(0)),
    "positive_last": (_QUATERNION, _is_unit, _signed(-1)),
    "negative": (_QUATERNION, _is_unit, np.negative),
}
"""Width of a rotation, the test that identifies it, and its change."""
