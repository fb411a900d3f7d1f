"""Lift the instructed block with the nearest hand."""

from __future__ import annotations

from ..cell import Cell, Program, pause
from ..moves import ABOVE, across, pick, up

_LIFT = 0.1


def program(cell: Cell) -> Program:
    """Pick and keep."""
    name = cell.truth["target"]
    place, yaw = cell.object_position(name), across(cell, name)
    hand = cell.nearest(place)
    yaw += hand.easiest_yaw([(place + up(ABOVE), yaw), (place, yaw), (place + up(_LIFT), yaw)])
    yield from pick(hand, place, yaw, lift=_LIFT)
    yield from pause(15)
