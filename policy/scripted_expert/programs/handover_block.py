"""Left hand takes one end of the block, right hand takes the other in the air and puts it down on the pad."""

from __future__ import annotations

import math

import numpy as np

from ..cell import Cell, Hand, Program, pause, together

_BLOCK, _PAD = "block", "pad"
_FROM_CENTER = 0.06  # m, grasps left and right of the block's centre
_ABOVE = 0.06
_MEETING = (0.0, -0.21, 0.08)  # world x and y, and above the table: where the block changes hands


def program(cell: Cell) -> Program:
    """Hand over in the air, then place by where the block really is in the hand."""
    left, right = cell.hands
    up = np.array([0.0, 0.0, _ABOVE])
    meeting = np.array([*_MEETING[:2], cell.table + _MEETING[2]])
    pad = cell.goal_position(_PAD)
    across = math.pi / 2  # the fingers close across the block, which is turned to lie along x

    block, yaw = cell.object_position(_BLOCK), cell.object_yaw(_BLOCK)
    end = block - _FROM_CENTER * _along(yaw)
    left_turn = left.easiest_yaw([(end + up, yaw + across), (meeting - _FROM_CENTER * _along(0.0), across)])
    right_turn = right.easiest_yaw([(meeting + _FROM_CENTER * _along(0.0), across), (pad + up, across)])
    yield from left.move(left.pointing_down(end + up, yaw + across + left_turn))
    yield from left.move(left.pointing_down(end, yaw + across + left_turn), speed=0.7)
    yield from left.grip(0.0, steps=8)
    yield from left.shift(up)
    bring = meeting - _FROM_CENTER * _along(0.0)
    yield from left.move(left.pointing_down(bring, across + left_turn))
    yield from pause(4)

    # Observe it again: the block may have turned or slipped a little on the way.
    block, yaw = cell.object_position(_BLOCK), cell.object_yaw(_BLOCK)
    end = block + _FROM_CENTER * _along(yaw)
    yield from right.move(right.pointing_down(end + up, yaw + across + right_turn))
    yield from right.move(right.pointing_down(end, yaw + across + right_turn), speed=0.7)
    yield from right.grip(0.0, steps=8)
    yield from left.grip(1.0, steps=6)
    yield from left.shift(up)

    yield from together(left.shift((-0.12, 0.05, 0.0)), _put_down(cell, right, pad, up))
    yield from pause(10)


def _put_down(cell: Cell, hand: Hand, pad: np.ndarray, up: np.ndarray) -> Program:
    """Bring the block's centre over the pad's, lower it, let go and leave."""
    held = hand.target[:3] - cell.object_position(_BLOCK)
    center = np.array([pad[0], pad[1], cell.table + cell.half_size(_BLOCK)[2] + 0.003])
    goal = hand.target.copy()
    goal[:3] = center + up + held
    yield from hand.move(goal)
    yield from hand.shift(-up, speed=0.7)
    yield from hand.grip(1.0, steps=6)
    yield from hand.shift(up)


def _along(yaw: float) -> np.ndarray:
    """Return the horizontal unit vector (3,) in a direction."""
    return np.array([math.cos(yaw), math.sin(yaw), 0.0])
