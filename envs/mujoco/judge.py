"""What tasks ask about objects and hands: how high, how far off, how upright, let go."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .physics import Physics

_OPEN = 0.6  # of the stroke: a gripper that has let go


def height(physics: Physics, name: str) -> float:
    """Return the height of a body's frame over the table, m."""
    return float(physics.body_pose(name)[2]) - physics.table_top


def off(physics: Physics, name: str, place: ArrayLike) -> float:
    """Return the larger error in x and y, m, of a body at a place (2,) of the table."""
    return float(np.max(np.abs(physics.body_pose(name)[:2] - np.asarray(place))))


def upright(physics: Physics, name: str) -> float:
    """Return the cosine of the angle between a body's z axis and the vertical."""
    return float(_axis(physics, name, [0.0, 0.0, 1.0])[2])


def heading(physics: Physics, name: str) -> float:
    """Return the direction of a body's x axis in the horizontal plane, rad."""
    along = _axis(physics, name, [1.0, 0.0, 0.0])
    return math.atan2(float(along[1]), float(along[0]))


def turned(first: float, second: float) -> float:
    """Return the angle between two directions, 0 to pi."""
    return abs(math.remainder(first - second, math.tau))


def held(physics: Physics, name: str) -> bool:
    """Return whether any one gripper holds a body between its fingers."""
    return any(physics.grasped(name, arm) for arm in range(physics.arm_count))


def touched(physics: Physics, *names: str) -> bool:
    """Return whether any arm touches any of some bodies."""
    return any(physics.touched(name, arm) for name in names for arm in range(physics.arm_count))


def let_go(physics: Physics, *names: str) -> bool:
    """Return whether all grippers are open and no arm touches any of some bodies."""
    return all(physics.opening(arm) > _OPEN for arm in range(physics.arm_count)) and not touched(physics, *names)


def _axis(physics: Physics, name: str, axis: ArrayLike) -> NDArray[np.float64]:
    return rotation.rotate(physics.body_pose(name)[spec.POSITION_DIM :], axis)
