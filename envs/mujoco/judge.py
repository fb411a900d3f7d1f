"""Predicates of tasks on objects and hands: height, distance, tilt, released.

Plain numbers and no arrays: they are evaluated after every control step, whose physics takes a tenth of a millisecond.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .physics import Physics

_OPEN = 0.6  # of the stroke: a gripper that has let go


def height(physics: Physics, name: str) -> float:
    """Return the height of a body's frame over the table, m."""
    return physics.position(name)[2] - physics.table_top


def off(physics: Physics, name: str, target: Iterable[float]) -> float:
    """Return the larger error in x and y, m, of a body at a place (2,) of the table."""
    (x, y, _), (there_x, there_y) = physics.position(name), target
    return float(max(abs(x - there_x), abs(y - there_y)))


def upright(physics: Physics, name: str) -> float:
    """Return the cosine of the angle between a body's z axis and the vertical."""
    return physics.axes(name)[8]


def heading(physics: Physics, name: str) -> float:
    """Return the direction of a body's x axis in the horizontal plane, rad."""
    turn = physics.axes(name)
    return math.atan2(turn[3], turn[0])


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
