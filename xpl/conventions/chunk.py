"""Which steps of an answer are executed, in which order, and at which rate.

Source: spec/v1/model_io.schema.json, `action.first` and `action.steps`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Callable

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.catalogue import Case, Convention, Mistake, deltas
from xpl.catalogue.deltas import is_arm, kept
from xpl.catalogue.edits import Site, everywhere, word
from xpl.catalogue.mistake import Commanded, Given, Obs, Step

_NAME = "chunk"
_TURN = slice(spec.POSITION_DIM, spec.POSE_DIM)

_Order = Callable[[Sequence[Given]], list[Step]]


def _in_block(case: Case) -> Iterator[Mistake]:
    if not case.block:
        return
    whole = [Site(("action",), case.block["action"])]
    for first in dict.fromkeys((0, 1, case.history - 1, 2)):
        yield from everywhere(whole, 1, f"first: {first}", _NAME, word("first", first, 0))


def _around(case: Case) -> Iterator[Mistake]:
    """Yield other orders of a chunk's steps, or of the changes that they add up, and answers to other questions."""
    orders: list[tuple[int, str, _Order]] = [
        (0, "chunk: reversed in time", lambda steps: list(steps[::-1])),
        (2, "chunk: all steps the first", lambda steps: [steps[0]] * len(steps)),
    ]
    for shift in dict.fromkeys((1, 2, max(1, case.history - 1), 3)):
        orders += [
            (0 if shift == 1 else 2, f"chunk: {shift} step{_s(shift)} earlier", _later(shift)),
            (0 if shift == 1 else 2, f"chunk: {shift} step{_s(shift)} later", _earlier(shift)),
        ]
    for rank, words, order in orders:
        yield Mistake(rank, words, _NAME, commanded=_ordered(order))
        for mode in deltas.modes(case.action_type):
            yield Mistake(rank, words, _NAME, commanded=_changes_ordered(order, mode))


def rates() -> Iterator[Mistake]:
    """Yield the change to a model whose steps last twice, three times, or half as long as control steps."""
    for rank, words, steps in (
        (0, "rate: half of the control rate", 2.0),
        (0, "rate: twice the control rate", 0.5),
        (2, "rate: a third of the control rate", 3.0),
    ):
        yield Mistake(rank, words, _NAME, commanded=partial(_timed, steps))


def _s(count: int) -> str:
    return "" if count == 1 else "s"


def _later(shift: int) -> _Order:
    """The adapter's chunk begins too late: what it misses is not known."""
    return lambda steps: [*[None] * min(shift, len(steps)), *steps[: max(0, len(steps) - shift)]]


def _earlier(shift: int) -> _Order:
    return lambda steps: [*steps[shift:], *[None] * min(shift, len(steps))]


def _ordered(order: _Order) -> Commanded:
    def commanded(answers: Sequence[Sequence[Given]], _seen: Sequence[Obs], _asked: Sequence[int]) -> list[list[Step]]:
        return [order(list(steps)) for steps in answers]

    return commanded


def _changes_ordered(order: _Order, mode: str) -> Commanded:
    """Order the changes of the arm from step to step, and what is no change as the steps."""

    def commanded(answers: Sequence[Sequence[Given]], seen: Sequence[Obs], asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked):
            state = seen[place][spec.Obs.STATE]
            bases = [state, *steps[:-1]]
            changes = [{**s, **deltas.apart(kept(s, is_arm), b, mode)} for s, b in zip(steps, bases)]
            base, made = state, list[Step]()
            for change in order(changes):
                if change is None:
                    made.append(None)
                    continue
                base = deltas.together(kept(change, is_arm), base, mode)
                made.append({**change, **base})
            result.append(made)
        return result

    return commanded


def _timed(
    lasts: float, answers: Sequence[Sequence[Given]], _seen: Sequence[object], _asked: Sequence[int]
) -> list[list[Step]]:
    return [[_at(chunk, (place + 1) / lasts - 1) for place in range(len(chunk))] for chunk in answers]


def _at(chunk: Sequence[Given], place: float) -> Step:
    """Return the step between two of a chunk; None before the first and after the last one."""
    if not 0 <= place <= len(chunk) - 1:
        return None
    one, other = chunk[int(place)], chunk[min(int(place) + 1, len(chunk) - 1)]
    share = place - int(place)
    return {key: _between(key, np.asarray(one[key]), np.asarray(other[key]), share) for key in one}


def _between(key: str, one: np.ndarray, other: np.ndarray, share: float) -> np.ndarray:
    if key.endswith(spec.State.EE_POSE) and float(one[_TURN] @ other[_TURN]) < 0:
        other = np.concatenate((other[: spec.POSITION_DIM], -other[_TURN]))
    mixed = (1 - share) * one + share * other
    if key.endswith(spec.State.EE_POSE):
        mixed[_TURN] = rotation.normalise(mixed[_TURN])
    return mixed


CONVENTION = Convention(
    _NAME, in_block=_in_block, around=_around, keys={"vectors": ["first", "steps"]}, applies=lambda _block: True
)
