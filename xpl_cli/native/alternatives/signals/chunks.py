"""Chunks and references: which step comes when, and what a command is counted from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from xpl import _spec as spec
from xpl_cli.native.alternatives.signals import deltas
from xpl_cli.native.alternatives.signals.signal import Commanded, Obs, Signal, Step

Given = Mapping[str, Any]
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
    yield Signal(1, "answers: to the observation before", "history", None, _of_question(1))
    yield Signal(1, "answers: to the observation after", "history", None, _of_question(-1))


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
            changes = [{**s, **deltas.apart(_kept(s, _arm), b, mode)} for s, b in zip(steps, bases, strict=True)]
            base, made = state, list[Step]()
            for change in order(changes):
                if change is None:
                    made.append(None)
                    continue
                base = deltas.together(_kept(change, _arm), base, mode)
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


# -- what a command is counted from ------------------------------------------------------------------------------------

_Base = Callable[[int, Sequence[Obs], Sequence[int]], Mapping[str, Any]]


def references(action_type: str, history: int, stride: int = 1) -> Iterator[Signal]:
    """Yield other references: of arms alone, since grippers are seldom deltas, of grippers alone, and of all."""
    modes = deltas.MODES if action_type == "ee" else deltas.MODES[:1]
    for later, told, chosen in ((0, "", _arm), (1, " (gripper)", _gripper), (1, " (arm and gripper)", _all)):
        for mode in modes:
            for rank, words, steps in (
                (0, "reference: delta_state, not absolute", _added(1)),
                (0, "reference: absolute, not delta_state", _added(-1)),
                (0, "reference: the state added once, not twice", _added(-1)),
                (0, "reference: cumulative, not delta_state", _cumulated),
                (0, "reference: delta_state, not cumulative", _differenced),
            ):
                yield Signal(rank + later, words + told, "action_reference", None, _counted(steps, mode, chosen))
            for age in dict.fromkeys((1, (history - 1) * stride, 2)):
                if age > 0:
                    words = f"reference: the newest observation, not that {age} step{_s(age)} before{told}"
                    moved = _from_other(_aged(age), mode, chosen)
                    yield Signal(1 + later, words, "action_reference", None, moved)
            yield Signal(
                later,
                f"reference: delta_command, not delta_state{told}",
                "action_reference",
                None,
                _commands(mode, chosen, to_command=True),
            )
            yield Signal(
                later,
                f"reference: delta_state, not delta_command{told}",
                "action_reference",
                None,
                _commands(mode, chosen, to_command=False),
            )


_Chosen = Callable[[str], bool]
_Steps = Callable[[list[dict[str, Any]], Mapping[str, Any], str], list[dict[str, Any]]]


def _arm(key: str) -> bool:
    return not key.endswith(spec.State.EE_JOINT_STATE)


def _gripper(key: str) -> bool:
    return key.endswith(spec.State.EE_JOINT_STATE)


def _all(_key: str) -> bool:
    return True


def _kept(step: Given, chosen: _Chosen) -> dict[str, Any]:
    return {key: value for key, value in step.items() if chosen(key)}


def _counted(change: _Steps, mode: str, chosen: _Chosen) -> Commanded:
    def commanded(answers: Sequence[Sequence[Given]], seen: Sequence[Obs], asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked, strict=True):
            state = seen[place][spec.Obs.STATE]
            moved = change([_kept(step, chosen) for step in steps], state, mode)
            result.append([{**step, **new} for step, new in zip(steps, moved, strict=True)])
        return result

    return commanded


def _added(times: int) -> _Steps:
    """Add the state to each step, or take it off."""

    def change(steps: list[dict[str, Any]], state: Mapping[str, Any], mode: str) -> list[dict[str, Any]]:
        way = deltas.together if times > 0 else deltas.apart
        return [way(step, state, mode) for step in steps]

    return change


def _cumulated(steps: list[dict[str, Any]], state: Mapping[str, Any], mode: str) -> list[dict[str, Any]]:
    base, result = state, []
    for step in steps:
        base = deltas.together(deltas.apart(step, state, mode), base, mode)
        result.append(base)
    return result


def _differenced(steps: list[dict[str, Any]], state: Mapping[str, Any], mode: str) -> list[dict[str, Any]]:
    bases = [state, *steps[:-1]]
    return [
        deltas.together(deltas.apart(step, base, mode), state, mode) for step, base in zip(steps, bases, strict=True)
    ]


def _aged(age: int) -> Callable[[int], int]:
    return lambda place: max(0, place - age)


def _from_other(place_of: Callable[[int], int], mode: str, chosen: _Chosen) -> Commanded:
    """Count from the newest observation what was counted from another one."""

    def commanded(answers: Sequence[Sequence[Given]], seen: Sequence[Obs], asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked, strict=True):
            true, other = seen[place][spec.Obs.STATE], seen[place_of(place)][spec.Obs.STATE]
            moved = [deltas.together(deltas.apart(_kept(s, chosen), other, mode), true, mode) for s in steps]
            result.append([{**step, **new} for step, new in zip(steps, moved, strict=True)])
        return result

    return commanded


def _commands(mode: str, chosen: _Chosen, *, to_command: bool) -> Commanded:
    """Count from the command before what was counted from the state at the call, or the other way round."""

    def commanded(answers: Sequence[Sequence[Given]], seen: Sequence[Obs], asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        last: Mapping[str, Any] | None = None  # of the true commands, or of the adapter's
        pending: Mapping[str, Any] | None = None
        for index, (steps, place) in enumerate(zip(answers, asked, strict=True)):
            if index and asked[index - 1] != place:  # a question that is put again counts from the same command
                last = pending
            state = seen[place][spec.Obs.STATE]
            start = last if last is not None else state
            kept = [_kept(step, chosen) for step in steps]
            if to_command:
                base, moved = start, []
                for step in kept:
                    base = deltas.together(deltas.apart(step, state, mode), base, mode)
                    moved.append(base)
            else:
                bases = [start, *kept[:-1]]
                moved = [
                    deltas.together(deltas.apart(step, base, mode), state, mode)
                    for step, base in zip(kept, bases, strict=True)
                ]
            result.append([{**step, **new} for step, new in zip(steps, moved, strict=True)])
            pending = (moved if to_command else kept)[-1]
        return result

    return commanded
