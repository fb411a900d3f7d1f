"""Pick the green block with the nearest hand and put it on the red one."""

from __future__ import annotations

from ..cell import Cell, Program, pause
from ..moves import ABOVE, across, pick, put, up

_LOWER, _UPPER = "red_block", "green_block"
_DROP = 0.002  # m over its place at which the block is let go


def program(cell: Cell) -> Program:
    """Pick, carry, put; both hands stay up afterwards."""
    start, goal = cell.object_position(_UPPER), cell.object_position(_LOWER)
    hand = cell.nearest(start)
    on_top = goal + up(cell.half_size(_LOWER)[2] + cell.half_size(_UPPER)[2] + _DROP)
    yaw = across(cell, _UPPER)
    yaw += hand.easiest_yaw([(start + up(ABOVE), yaw), (start, yaw), (on_top + up(ABOVE), yaw), (on_top, yaw)])
    yield from pick(hand, start, yaw, lift=0.1)
    yield from put(cell, hand, _UPPER, on_top)
    yield from pause(10)
