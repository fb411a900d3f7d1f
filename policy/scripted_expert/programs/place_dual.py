"""Both hands at once: each picks the block on its side, waits for the other, and puts it on its pad."""

from __future__ import annotations

from ..cell import Cell, Hand, Program, pause, together
from ..moves import ABOVE, across, pick, put, up

_PAIRS = (("red_block", "red_pad"), ("blue_block", "blue_pad"))
_DROP = 0.002  # m over the pad at which a block is let go


def program(cell: Cell) -> Program:
    """Pick together, put together."""
    jobs = [(hand, block, pad) for hand, (block, pad) in zip(cell.hands, _PAIRS, strict=True)]
    yaws = [_yaw(cell, *job) for job in jobs]
    yield from together(
        *(pick(hand, cell.object_position(block), yaw) for (hand, block, _), yaw in zip(jobs, yaws, strict=True))
    )
    yield from pause(2)
    yield from together(*(put(cell, hand, block, _place(cell, block, pad)) for hand, block, pad in jobs))
    yield from pause(10)


def _place(cell: Cell, block: str, pad: str) -> list[float]:
    x, y, table = cell.goal_position(pad).tolist()
    return [x, y, table + float(cell.half_size(block)[2]) + _DROP]


def _yaw(cell: Cell, hand: Hand, block: str, pad: str) -> float:
    start, goal, yaw = cell.object_position(block), cell.goal_position(pad), across(cell, block)
    return yaw + hand.easiest_yaw([(start + up(ABOVE), yaw), (start, yaw), (goal + up(ABOVE), yaw), (goal, yaw)])
