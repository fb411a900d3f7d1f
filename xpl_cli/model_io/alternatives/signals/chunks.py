"""Chunks: which step comes when, and which question is answered."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from xpl import _spec as spec
from xpl_cli.model_io.alternatives.signals import deltas
from xpl_cli.model_io.alternatives.signals.deltas import is_arm, kept
from xpl_cli.model_io.alternatives.signals.signal import Commanded, Given, Obs, Signal, Step

_Order = Callable[[Sequence[Given]], list[Step]]


def chunks(action_type: str, history: int) -> Iterator[Signal]:
    """Yield other orders of a chunk's steps, or of the changes that they add up, and answers to other questions."""
    orders: list[tuple[int, str, _Order]] = [
        (0, "chunk: reversed in time", lambda steps: list(steps[::-1])),
        (2, "chunk: all steps the first", lambda steps: [steps[0]] * len(steps)),
    ]
    for shift in dict.fromkeys((1, 2, max(1, history - 1), 3)):
        orders += [
            (0 if shift == 1 else 2, f"chunk: {shift} step{_s(shift)} earlier", _later(shift)),
            (0 if shift == 1 else 2, f"chunk: {shift} step{_s(shift)} later", _earlier(shift)),
        ]
    modes = deltas.MODES if action_type == "ee" else deltas.MODES[:1]
    for rank, words, order in orders:
        yield Signal(rank, words, "chunk", None, _ordered(order))
        for mode in modes:
            yield Signal(rank, words, "chunk", None, _changes_ordered(order, mode))
    yield Signal(1, "answers: to the observation before", "history_length", None, _of_question(1))
    yield Signal(1, "answers: to the observation after", "history_length", None, _of_question(-1))


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
        for steps, place in zip(answers, asked, strict=True):
            state = seen[place][spec.Obs.STATE]
            bases = [state, *steps[:-1]]
            changes = [{**s, **deltas.apart(kept(s, is_arm), b, mode)} for s, b in zip(steps, bases, strict=True)]
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


def _of_question(later: int) -> Commanded:
    """Take the answer of another question of the episode; where there is none, it is not known."""

    def commanded(answers: Sequence[Sequence[Given]], _seen: Sequence[Obs], _asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        for index, steps in enumerate(answers):
            other = index - later
            result.append(list(answers[other]) if 0 <= other < len(answers) else [None] * len(steps))
        return result

    return commanded
