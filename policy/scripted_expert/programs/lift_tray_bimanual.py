"""Both hands grasp a handle each and lift at the same pace."""

from __future__ import annotations

import numpy as np

from ..cell import Cell, Program, pause, together
from ..moves import ABOVE, across, pick, up

_TRAY = "tray"
_HIGHER = 0.008  # m over the handle's centre, so that the fingers stay clear of the tray
_LIFT = 0.1


def program(cell: Cell) -> Program:
    """Grasp along the tray's short side, then lift together."""
    yaw = across(cell, _TRAY)
    grasps = [place + up(_HIGHER) for place in cell.object_points(_TRAY, "handles")]
    turns = [
        hand.easiest_yaw([(grasp + up(ABOVE), yaw), (grasp, yaw), (grasp + up(_LIFT), yaw)])
        for hand, grasp in zip(cell.hands, grasps, strict=True)
    ]
    yield from together(
        *(pick(hand, grasp, yaw + turn, lift=0.0) for hand, grasp, turn in zip(cell.hands, grasps, turns, strict=True))
    )
    yield from together(*(hand.shift(np.array([0.0, 0.0, _LIFT]), speed=0.5) for hand in cell.hands))
    yield from pause(15)
