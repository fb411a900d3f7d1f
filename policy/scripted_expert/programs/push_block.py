"""Push with two fingers side by side, with the block's position observed at every step."""

from __future__ import annotations

import math

import numpy as np

from xpl import _spec as spec

from ..cell import Cell, Hand, Program, pause
from ..moves import ABOVE, up

_BLOCK, _PAD = "block", "pad"
_OPEN = 0.6  # two points of contact keep the block from turning
_BEHIND = 0.045  # m between the block's side and the tcp before the push
_HIGH = 0.022  # m of the tcp over the table: the fingers end a centimetre lower
_LEAN = 0.2  # rad: the fingertips lead, so that the push lifts the block rather than jams it against the table
_STEP = 0.005  # m of one control step while pushing
_SLOWEST, _PACE = 0.0012, 0.25  # the last steps are shorter: a part of the way that is left
_ASIDE = 0.002  # m of one control step, sideways
_GENTLY = 0.5  # of the usual speed
_CLOSE_ENOUGH = 0.004
_LONGEST = 150  # control steps


def program(cell: Cell) -> Program:
    """Come down behind the block, push it straight to the pad, back off."""
    block, pad = cell.object_position(_BLOCK), cell.goal_position(_PAD)
    hand = cell.nearest(block)
    ahead = _direction(pad - block)
    touch = float(cell.half_size(_BLOCK)[1]) + _BEHIND
    start = np.array([*(block - touch * ahead)[:2], cell.table + _HIGH])
    end = np.array([*(pad - touch * ahead)[:2], cell.table + _HIGH])
    yaw = math.atan2(ahead[1], ahead[0]) - math.pi / 2  # the fingers side by side, across the push
    lean = _LEAN * ahead
    yaw += hand.easiest_yaw([(start + up(ABOVE), yaw), (start, yaw), (end, yaw)], lean)
    hand.opening = _OPEN
    yield from hand.move(hand.pointing_down(start + up(ABOVE), yaw, lean))
    yield from hand.move(hand.pointing_down(start, yaw, lean), speed=_GENTLY)
    yield from _push(cell, hand, pad, ahead, yaw)
    yield from hand.shift(-_BEHIND * ahead)
    yield from hand.shift(up(ABOVE))
    yield from hand.grip(spec.GRIPPER_OPEN, steps=12)


def _push(cell: Cell, hand: Hand, pad: np.ndarray, ahead: np.ndarray, yaw: float) -> Program:
    """Advance until the block is there, and sideways as it strays: friction takes it along."""
    side = np.array([-ahead[1], ahead[0], 0.0])
    for _ in range(_LONGEST):
        left = pad - cell.object_position(_BLOCK)
        way, astray = float(left @ ahead), float(left @ side)
        if way < _CLOSE_ENOUGH:
            break
        advance = min(_STEP, max(_SLOWEST, _PACE * way))
        aside = min(_ASIDE, max(-_ASIDE, _PACE * astray))
        hand.target = hand.pointing_down(hand.target[:3] + advance * ahead + aside * side, yaw, _LEAN * ahead)
        yield
    yield from pause(4)


def _direction(offset: np.ndarray) -> np.ndarray:
    """Return the horizontal unit vector (3,) along an offset."""
    flat = np.array([offset[0], offset[1], 0.0])
    return flat / math.hypot(flat[0], flat[1])
