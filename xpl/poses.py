"""Poses ``[x, y, z, qw, qx, qy, qz]`` (m, unit quaternion): make, chain, invert, apply."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["compose", "invert", "pose", "transform"]


def pose(position: ArrayLike, quaternion: ArrayLike) -> NDArray[np.float64]:
    """Return the pose (..., 7) of positions (..., 3) and quaternions (..., 4)."""
    place, turn = np.asarray(position, dtype=np.float64), np.asarray(quaternion, dtype=np.float64)
    if place.ndim == turn.ndim == 1:  # one pose: broadcasting would cost ten times the rest
        return np.concatenate((place, turn))
    leading = np.broadcast_shapes(place.shape[:-1], turn.shape[:-1])
    split = spec.POSITION_DIM
    parts = np.broadcast_to(place, (*leading, split)), np.broadcast_to(turn, (*leading, spec.POSE_DIM - split))
    return np.concatenate(parts, axis=-1)


def compose(outer: ArrayLike, inner: ArrayLike) -> NDArray[np.float64]:
    """Return `inner` (..., 7), given in the frame `outer` (..., 7), in the frame that `outer` is given in."""
    frame, local = np.asarray(outer, dtype=np.float64), np.asarray(inner, dtype=np.float64)
    split = spec.POSITION_DIM
    return pose(transform(frame, local[..., :split]), rotation.multiply(frame[..., split:], local[..., split:]))


def invert(frame: ArrayLike) -> NDArray[np.float64]:
    """Return the inverse of poses (..., 7): the outer frame seen from the inner."""
    array = np.asarray(frame, dtype=np.float64)
    back = rotation.conjugate(array[..., spec.POSITION_DIM :])
    return pose(-rotation.rotate(back, array[..., : spec.POSITION_DIM]), back)


def transform(frame: ArrayLike, point: ArrayLike) -> NDArray[np.float64]:
    """Return points (..., 3), given in the frame (..., 7), in the frame that `frame` is given in."""
    array = np.asarray(frame, dtype=np.float64)
    split = spec.POSITION_DIM
    moved: NDArray[np.float64] = array[..., :split] + rotation.rotate(array[..., split:], point)
    return moved
