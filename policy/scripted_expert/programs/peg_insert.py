"""Grasp the peg above its middle, turn it square to the hole, observe it again, lower it."""

from __future__ import annotations

import math

import numpy as np

from ..cell import Cell, Program, pause
from ..moves import ABOVE, carried_upright, pick, release, up

_PEG = "peg"
_GRASP = 0.013  # m over the peg's centre, so that the fingers end above the socket
_CLOSE, _DROP = 0.05, 0.003  # m of the peg over the table: before it enters the socket, when it is let go
_IN, _ATTEMPTS = 0.015, 3  # m over its place below which the peg has entered
_LEAN = 0.25  # rad
_QUARTER = math.radians(90.0)
_SLOWLY = 0.4
_GENTLY = 0.7  # of the usual speed, so that the peg does not slip


def program(cell: Cell) -> Program:
    """Pick, align, insert."""
    start, goal = cell.object_position(_PEG), cell.goal_position("hole")
    center = goal + up(float(cell.half_size(_PEG)[2]))
    hand = cell.nearest(start)
    square = _QUARTER * round(cell.object_yaw(_PEG) / _QUARTER)
    # Arms reach forward more easily than straight down, and the fingers lie flat on the peg as long as they lean across
    # the direction in which they slide: of the peg's two pairs of sides, those are grasped that allow it.
    outward = goal - hand.base[:3]
    away = math.atan2(outward[1], outward[0])
    sides = _QUARTER * round((away + _QUARTER - square) / _QUARTER)
    yaw, aligned = cell.object_yaw(_PEG) + sides, square + sides
    lean = _LEAN * np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    grasp, goal_grasp = start + up(_GRASP), center + up(_GRASP)
    turn = hand.easiest_yaw(
        [(grasp + up(ABOVE), yaw), (grasp, yaw), (goal_grasp + up(ABOVE), aligned), (goal_grasp, aligned)], lean
    )
    yield from pick(hand, grasp, yaw + turn, lift=0.08, lean=lean)
    yield from hand.move(carried_upright(cell, hand, _PEG, center + up(ABOVE), square), speed=_GENTLY)
    for _ in range(_ATTEMPTS):
        yield from hand.move(carried_upright(cell, hand, _PEG, center + up(_CLOSE), square), speed=_GENTLY)
        yield from pause(5)
        yield from hand.move(carried_upright(cell, hand, _PEG, center + up(_DROP), square), speed=_SLOWLY)
        yield from pause(3)
        if cell.object_position(_PEG)[2] - center[2] < _IN:
            break
    yield from release(hand)
    yield from pause(10)
