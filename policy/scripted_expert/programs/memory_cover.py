"""Wait until the cubes are covered, then lift the cover of the red one by its knob."""

from __future__ import annotations

from ..cell import Cell, Program, pause
from ..moves import ABOVE, across, pick, up

_LIFT = 0.08


def program(cell: Cell) -> Program:
    """Wait, pick and keep."""
    while not cell.truth["covered"]:
        yield
    yield from pause(3)
    name = cell.truth["target"]
    knob, yaw = cell.object_points(name, "knob")[0], across(cell, name)
    hand = cell.nearest(knob)
    yaw += hand.easiest_yaw([(knob + up(ABOVE), yaw), (knob, yaw), (knob + up(_LIFT), yaw)])
    yield from pick(hand, knob, yaw, lift=_LIFT)
    yield from pause(15)
