"""Common motions of the programs: pick from above, carry, put down."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.poses import pose

from .cell import UPRIGHT, Cell, Hand, Program, pause

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

ABOVE = 0.07
"""m over a grasp or a place from which hands come and to which they leave."""

_LEVEL = 1e-4  # rad that count as upright
_SLOW = 0.5  # of the usual speed, where contact is near


def up(height: float) -> np.ndarray:
    """Return the offset (3,) straight up."""
    return np.array([0.0, 0.0, height])


def across(cell: Cell, name: str) -> float:
    """Return the yaw, rad, of fingers that close across an object, along its y axis."""
    return cell.object_yaw(name) + math.pi / 2


def pick(hand: Hand, position: ArrayLike, yaw: float, lift: float = ABOVE, lean: ArrayLike = UPRIGHT) -> Program:
    """Grasp what is at a position (3,) from above, fingers closing along `yaw` and leaning, and lift it by `lift` m."""
    position = np.asarray(position)
    yield from hand.move(hand.pointing_down(position + up(ABOVE), yaw, lean))
    yield from hand.move(hand.pointing_down(position, yaw, lean), speed=_SLOW)
    yield from hand.grip(spec.GRIPPER_CLOSED, steps=8)
    yield from hand.shift(up(lift), speed=_SLOW)


def put(cell: Cell, hand: Hand, name: str, center: ArrayLike, yaw: float | None = None) -> Program:
    """Put a held object's centre at a position (3,), turned to `yaw` if that is given, and let go.

    Looks again where the object is in the hand once it is over its place.
    """
    center = np.asarray(center)
    yield from hand.move(carried(cell, hand, name, center + up(ABOVE), yaw))
    yield from pause(4)
    yield from hand.move(carried(cell, hand, name, center, yaw), speed=_SLOW)
    yield from pause(2)
    yield from release(hand)


def release(hand: Hand) -> Program:
    """Open the gripper and leave straight up."""
    yield from hand.grip(spec.GRIPPER_OPEN, steps=8)
    yield from hand.shift(up(ABOVE))


def carried(cell: Cell, hand: Hand, name: str, center: ArrayLike, yaw: float | None = None) -> np.ndarray:
    """Return the tcp pose (7,) with which a held object's centre is at a position, turned about z to `yaw` if given."""
    turn = 0.0 if yaw is None else math.remainder(yaw - cell.object_yaw(name), math.tau)
    return _moved(cell, hand, name, center, rotation.from_axis_angle([0.0, 0.0, turn]))


def carried_upright(cell: Cell, hand: Hand, name: str, center: ArrayLike, yaw: float) -> np.ndarray:
    """Return the tcp pose (7,) as `carried` does, tilted so that the object stands upright in it."""
    turn = math.remainder(yaw - cell.object_yaw(name), math.tau)
    upright = _upright(cell.object_axis(name))
    return _moved(cell, hand, name, center, rotation.multiply(rotation.from_axis_angle([0.0, 0.0, turn]), upright))


def _moved(cell: Cell, hand: Hand, name: str, center: ArrayLike, turned: np.ndarray) -> np.ndarray:
    split = spec.POSITION_DIM
    held = hand.target[:split] - cell.object_position(name)
    return pose(np.asarray(center) + rotation.rotate(turned, held), rotation.multiply(turned, hand.target[split:]))


def _upright(axis: np.ndarray) -> np.ndarray:
    """Return the rotation (4,) about a horizontal axis that makes a unit vector (3,) point up."""
    x, y, z = axis.tolist()
    sine = math.hypot(x, y)
    if sine < _LEVEL:
        return rotation.identity()
    return rotation.from_axis_angle(np.array([y, -x, 0.0]) * (math.atan2(sine, z) / sine))
