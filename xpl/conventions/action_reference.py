"""What commands are counted from, and where a change is applied.

Source: spec/v1/model_io.schema.json#/$defs/reference and applied.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Callable, Optional

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import Case, Convention, Mistake, deltas
from xpl.catalogue.deltas import is_arm, kept
from xpl.catalogue.edits import Block, Site, everywhere, parts, without, word
from xpl.catalogue.mistake import Commanded, Given, Obs, Step, Steps

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

_NAME = "action_reference"
REFERENCES = ("absolute", "delta_state", "cumulative", "delta_command")
"""The likeliest first."""
_APPLIED = ("fixed", "body", "numbers")

Add = Callable[[Any, Any, int], Any]
"""Returns what a base and a change, or a value, come to, of both and the number of the step."""


def counted(reference: str, changes: Sequence[Any], state: Any, command: Any, add: Add) -> list[Any]:
    """Return the commands that changes lead to.

    Args:
        reference: one of REFERENCES but absolute.
        changes: of each step.
        state: at the call.
        command: the last one before the call.
        add: a change to what it is counted from.
    """
    base, result = command if reference == "delta_command" else state, []
    for index, change in enumerate(changes):
        result.append(add(base, change, index))
        if reference != "delta_state":
            base = result[-1]
    return result


def uncounted(reference: str, commands: Sequence[Any], state: Any, command: Any, subtract: Add) -> list[Any]:
    """Return the changes that lead to commands; the inverse of `counted`."""
    base, result = command if reference == "delta_command" else state, []
    for index, wanted in enumerate(commands):
        result.append(subtract(base, wanted, index))
        if reference != "delta_state":
            base = wanted
    return result


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _in_block(case: Case) -> Iterator[Mistake]:
    block: Block = case.block
    if not block:
        return
    whole = [Site(("action",), block["action"])]
    for reference in REFERENCES:
        yield from everywhere(whole, 0, f"reference: {reference}", _NAME, word("reference", reference))
    of_parts = [site for site in parts(block, "joints", "hand", "position", "rotation") if site.group == "action"]
    for reference in REFERENCES:
        change = word("reference", reference, block["action"]["reference"])
        yield from everywhere(of_parts, 1, f"reference of the part: {reference}", _NAME, change)
    yield from everywhere(of_parts, 1, "reference of the part: none", _NAME, without("reference"))
    grippers = [site for site in parts(block, "gripper") if site.group == "action"]
    for reference in REFERENCES:
        rank = 1 if reference in ("delta_state", "absolute") else 3
        change = word("reference", reference, "absolute")
        yield from everywhere(grippers, rank, f"gripper: reference: {reference}", _NAME, change)
    poses = [site for site in parts(block, "position", "rotation") if site.group == "action"]
    for applied in _APPLIED:
        yield from everywhere(poses, 0, f"applied: {applied}", _NAME, word("applied", applied, "fixed"))


_Chosen = Callable[[str], bool]
_Change = Callable[[Steps, int, Sequence[Obs], Optional["_Command"]], Steps]
"""Returns the fields of the steps of an answer, of the adapter's, the place of the question, what was observed, and the
command before."""


@dataclass(frozen=True)
class _Command:
    """The last command of an answer: as the adapter gave it, and as the change has it."""

    given: Given
    true: Given


def _around(case: Case) -> Iterator[Mistake]:
    """Yield other references: of arms, since grippers are seldom deltas, of grippers, of all, and of each arm."""
    modes = deltas.modes(case.action_type)
    ages = [age for age in dict.fromkeys((1, (case.history - 1) * case.stride, 2)) if age > 0]

    def mistake(rank: int, words: str, change: _Change, chosen: _Chosen) -> Mistake:
        return Mistake(rank, words, _NAME, commanded=_counted(change, chosen))

    for later, told, chosen in _scopes(case.embodiment):
        for mode in modes:
            changes: list[tuple[int, str, _Change]] = [
                (0, "delta_state, not absolute", _added(mode)),
                (0, "the state added once less", _taken_off(mode)),
                (0, "cumulative, not delta_state", _cumulated(mode)),
                (0, "delta_state, not cumulative", _differenced(mode)),
                (0, "delta_command, not delta_state", _commands(mode, to_command=True)),
                (0, "delta_state, not delta_command", _commands(mode, to_command=False)),
            ]
            for age in ages:
                words = f"the newest observation, not that {age} step{'' if age == 1 else 's'} before"
                changes.append((1, words, _from_older(age, mode)))
            if mode == deltas.MODES[0] and case.action_type == "joint":
                changes.append((2, "cumulative over the steps, not over the numbers", _across))
            for rank, words, change in changes:
                yield mistake(rank + later, f"reference: {words}{told}", change, chosen)
        applied = itertools.permutations(deltas.APPLIED, 2) if len(modes) > 1 and "gripper" not in told else ()
        for one, other in applied:
            yield mistake(later, f"applied: {one}, not {other}{told}", _applied(other, one), chosen)
    for (one, other), mode in itertools.product(itertools.permutations(case.embodiment.prefixes, 2), modes):
        words = f"reference: the {one.rstrip('_')} arm's own state, not the other's"
        yield mistake(1, words, _from_arm(one, other, mode), functools.partial(_is_of, one, arm=True))


def _scopes(embodiment: Embodiment) -> Iterator[tuple[int, str, _Chosen]]:
    yield 0, "", is_arm
    yield 1, " (gripper)", lambda key: not is_arm(key)
    yield 1, " (arm and gripper)", lambda _key: True
    prefixes = embodiment.prefixes
    for prefix in prefixes if len(prefixes) > 1 else ():
        yield 1, f" ({prefix.rstrip('_')})", functools.partial(_is_of, prefix, arm=True)
        yield 2, f" (gripper {prefix.rstrip('_')})", functools.partial(_is_of, prefix, arm=False)


def _is_of(prefix: str, key: str, *, arm: bool) -> bool:
    return key.startswith(prefix) and is_arm(key) == arm


def _counted(change: _Change, chosen: _Chosen) -> Commanded:
    def commanded(answers: Sequence[Sequence[Given]], seen: Sequence[Obs], asked: Sequence[int]) -> list[list[Step]]:
        result: list[list[Step]] = []
        last: _Command | None = None
        pending: _Command | None = None
        for index, (steps, place) in enumerate(zip(answers, asked)):
            if index and asked[index - 1] != place:  # a question that is put again counts from the same command
                last = pending
            moved = change([kept(step, chosen) for step in steps], place, seen, last)
            result.append([_whole(step, new) for step, new in zip(steps, moved)])
            pending = _Command(kept(steps[-1], chosen), moved[-1])
        return result

    return commanded


def _whole(step: Given, new: Given) -> dict[str, np.ndarray]:
    """Return a step with its new fields; what a clipped opening of a gripper would be is not known."""
    result = {**step, **new}
    for key in new:
        value = np.asarray(step[key], np.float64)
        if key.endswith(spec.State.EE_JOINT_STATE) and value.shape == (1,):
            clipped = (value <= spec.GRIPPER_CLOSED) | (value >= spec.GRIPPER_OPEN)
            inside = np.clip(np.asarray(new[key], np.float64), spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN)
            result[key] = np.where(clipped, np.nan, inside)
    return result


def _state(seen: Sequence[Obs], place: int) -> Given:
    state: Given = seen[place][spec.Obs.STATE]
    return state


def _added(mode: str) -> _Change:
    return lambda steps, place, seen, _last: [deltas.together(step, _state(seen, place), mode) for step in steps]


def _taken_off(mode: str) -> _Change:
    return lambda steps, place, seen, _last: [deltas.apart(step, _state(seen, place), mode) for step in steps]


def _cumulated(mode: str) -> _Change:
    def change(steps: Steps, place: int, seen: Sequence[Obs], _last: _Command | None) -> Steps:
        state = _state(seen, place)
        return _summed((deltas.apart(step, state, mode) for step in steps), state, mode)

    return change


def _summed(changes: Iterable[Given], base: Given, mode: str) -> Steps:
    result: Steps = []
    for change in changes:
        base = deltas.together(change, base, mode)
        result.append(dict(base))
    return result


def _differenced(mode: str) -> _Change:
    def change(steps: Steps, place: int, seen: Sequence[Obs], _last: _Command | None) -> Steps:
        state = _state(seen, place)
        bases = [state, *steps[:-1]]
        changes = (deltas.apart(step, base, mode) for step, base in zip(steps, bases))
        return [deltas.together(one, state, mode) for one in changes]

    return change


def _from_older(age: int, mode: str) -> _Change:
    """Count from the newest observation what was counted from an older one."""

    def change(steps: Steps, place: int, seen: Sequence[Obs], _last: _Command | None) -> Steps:
        true, other = _state(seen, place), _state(seen, max(0, place - age))
        return [deltas.together(deltas.apart(step, other, mode), true, mode) for step in steps]

    return change


def _from_arm(one: str, other: str, mode: str) -> _Change:
    """Count from an arm's own state what was counted from the other's."""

    def change(steps: Steps, place: int, seen: Sequence[Obs], _last: _Command | None) -> Steps:
        true = _state(seen, place)
        taken = {key: true[other + key.removeprefix(one)] for key in true if key.startswith(one)}
        return [deltas.together(deltas.apart(step, taken, mode), true, mode) for step in steps]

    return change


def _across(steps: Steps, place: int, seen: Sequence[Obs], _last: _Command | None) -> Steps:
    """Add up over the steps what was added up over the numbers of each."""
    state = _state(seen, place)
    apart = [deltas.apart(step, state, deltas.MODES[0]) for step in steps]
    single = [{key: np.diff(value, prepend=0.0) for key, value in step.items()} for step in apart]
    return _summed(single, state, deltas.MODES[0])


def _applied(done: str, wanted: str) -> _Change:
    """Apply a change of pose in another frame than the adapter did."""

    def change(steps: Steps, place: int, seen: Sequence[Obs], _last: _Command | None) -> Steps:
        state = _state(seen, place)
        return [deltas.together(deltas.apart(step, state, done), state, wanted) for step in steps]

    return change


def _commands(mode: str, *, to_command: bool) -> _Change:
    """Count from the command before what was counted from the state at the call, or the other way round."""

    def change(steps: Steps, place: int, seen: Sequence[Obs], last: _Command | None) -> Steps:
        state = _state(seen, place)
        if to_command:
            start = state if last is None else last.true
            return _summed((deltas.apart(step, state, mode) for step in steps), start, mode)
        bases = [state if last is None else last.given, *steps[:-1]]
        changes = (deltas.apart(step, base, mode) for step, base in zip(steps, bases))
        return [deltas.together(one, state, mode) for one in changes]

    return change


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    keys={
        place: ["reference", "applied"] for place in ("vectors", "joints", "hand", "gripper", "position", "rotation")
    },
    applies=lambda _block: True,
)
