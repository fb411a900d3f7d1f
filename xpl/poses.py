"""Poses ``[x, y, z, qw, qx, qy, qz]`` (m, unit quaternion): make, compose, invert, transform points."""

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
    positions, turn = np.asarray(position, dtype=np.float64), np.asarray(quaternion, dtype=np.float64)
    if positions.ndim == turn.ndim == 1:  # one pose: ten times faster than broadcasting
        return np.concatenate((positions, turn))
    leading = np.broadcast_shapes(positions.shape[:-1], turn.shape[:-1])
    split = spec.POSITION_DIM
    parts = np.broadcast_to(positions, (*leading, split)), np.broadcast_to(turn, (*leading, spec.POSE_DIM - split))
    return np.concatenate(parts, axis=-1)


def compose(outer: ArrayLike, inner: ArrayLike) -> NDArray[np.float64]:
    """Return the pose `inner` (..., 7), which is relative to `outer` (..., 7), in the frame of `outer`."""
    frame, local = np.asarray(outer, dtype=np.float64), np.asarray(inner, dtype=np.float64)
    split = spec.POSITION_DIM
    return pose(transform(frame, local[..., :split]), rotation.multiply(frame[..., split:], local[..., split:]))


def invert(frame: ArrayLike) -> NDArray[np.float64]:
    """Return the inverse of poses (..., 7)."""
    array = np.asarray(frame, dtype=np.float64)
    back = rotation.conjugate(array[..., spec.POSITION_DIM :])
    return pose(-rotation.rotate(back, array[..., : spec.POSITION_DIM]), back)


def transform(frame: ArrayLike, point: ArrayLike) -> NDArray[np.float64]:
    """Return points (..., 3), which are relative to `frame` (..., 7), in the parent frame."""
    array = np.asarray(frame, dtype=np.float64)
    split = spec.POSITION_DIM
    moved: NDArray[np.float64] = array[..., :split] + rotation.rotate(array[..., split:], point)
    return moved
