"""Grasp the stem, drag the T along the table, observe it again, let go."""

from __future__ import annotations

from ..cell import Cell, Program, pause
from ..moves import ABOVE, carried, pick, release, up

_T = "T"
_SLOWLY = 0.6


def program(cell: Cell) -> Program:
    """Drag to the outline in one motion, then correct once."""
    stem = cell.object_points(_T, "stem")[0]
    center, wanted = cell.goal_position("outline"), cell.goal_yaw("outline")
    center[2] = cell.object_position(_T)[2]
    hand, yaw = cell.nearest(stem), cell.object_yaw(_T)
    turn = hand.easiest_yaw([(stem + up(ABOVE), yaw), (stem, yaw), (center, wanted), (center + up(ABOVE), wanted)])
    yield from pick(hand, stem, yaw + turn, lift=0.0)
    for _ in range(2):
        goal = carried(cell, hand, _T, center, wanted)
        goal[2] = hand.target[2]  # the table bears the T: it is dragged, at the height at which it was grasped
        yield from hand.move(goal, speed=_SLOWLY)
        yield from pause(4)
    yield from release(hand)
    yield from pause(10)
