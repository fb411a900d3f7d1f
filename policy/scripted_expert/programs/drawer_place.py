"""One hand pulls the drawer open and leaves; the hand nearest to the cube puts it in."""

from __future__ import annotations

import math

from xpl import _spec as spec

from ..cell import Cell, Program, pause
from ..moves import ABOVE, across, pick, put, release, up

_CUBE, _DRAWER = "cube", "drawer"
_PULL = 0.13
_OUT_OF_THE_WAY = 0.1
_DROP = 0.01  # m over the drawer's floor
_SLOWLY = 0.5


def program(cell: Cell) -> Program:
    """Open, then pick and put."""
    handle = cell.object_points(_DRAWER, "handle")[0]
    hand = cell.nearest(handle)
    pulled = handle - [0.0, _PULL, 0.0]
    yaw = hand.easiest_yaw([(handle + up(ABOVE), 0.0), (handle, 0.0), (pulled, 0.0)])
    yield from pick(hand, handle, yaw, lift=0.0)
    yield from hand.shift([0.0, -_PULL, 0.0], speed=_SLOWLY)
    yield from pause(2)
    yield from release(hand)

    cube = cell.object_position(_CUBE)
    place = cell.object_points(_DRAWER, "floor")[0] + up(float(cell.half_size(_CUBE)[2]) + _DROP)
    carrier = cell.nearest(cube)
    if carrier is not hand:
        yield from hand.shift([math.copysign(_OUT_OF_THE_WAY, hand.base[0]), 0.0, 0.0])
    yaw = across(cell, _CUBE)
    yaw += carrier.easiest_yaw([(cube + up(ABOVE), yaw), (cube, yaw), (place + up(ABOVE), yaw), (place, yaw)])
    yield from pick(carrier, cube, yaw, lift=0.12)
    yield from put(cell, carrier, _CUBE, place)
    yield from carrier.grip(spec.GRIPPER_OPEN, steps=10)
