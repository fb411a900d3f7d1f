"""Grasp the cube from above with the nearest hand and lift it."""

from __future__ import annotations

import math

import numpy as np

from ..cell import Cell, Program, pause

_CUBE = "cube"
_ABOVE, _LIFT = 0.06, 0.09
_ATTEMPTS = 3


def program(cell: Cell) -> Program:
    """Lift, and check that the cube was lifted."""
    cube = cell.object_position(_CUBE)
    hand = min(cell.hands, key=lambda candidate: float(np.sum((candidate.base[:2] - cube[:2]) ** 2)))
    up = np.array([0.0, 0.0, _ABOVE])
    for _ in range(_ATTEMPTS):
        cube, yaw = cell.object_position(_CUBE), cell.object_yaw(_CUBE) + math.pi / 2
        yaw += hand.easiest_yaw([(cube + up, yaw), (cube, yaw)])
        yield from hand.move(hand.pointing_down(cube + up, yaw))
        yield from hand.move(hand.pointing_down(cube, yaw), speed=0.6)
        yield from hand.grip(0.0, steps=8)
        yield from hand.shift((0.0, 0.0, _LIFT))
        yield from pause(4)
        if cell.object_position(_CUBE)[2] - cube[2] > 0.5 * _LIFT:
            return
        yield from hand.grip(1.0, steps=6)
