"""Reference of actions (absolute or delta), and the frame in which a delta is applied.

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
from xpl.catalogue import AdapterCase, Convention, Mistake, deltas
from xpl.catalogue.deltas import is_arm, select_fields
from xpl.catalogue.edits import Block, Site, mistakes_at_sites, parts, remove_key, set_key
from xpl.catalogue.mistake import ActionChange, ArrayMap, Obs, OptionalStep, Steps

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

_NAME = "action_reference"
REFERENCES = ("absolute", "delta_state", "cumulative", "delta_command")
"""The likeliest first."""
_APPLIED = ("fixed", "body", "numbers")

Add = Callable[[Any, Any, int], Any]
"""Combines a base and a delta (or a value); the third argument is the index of the step."""


def commands_from_deltas(reference: str, changes: Sequence[Any], state: Any, command: Any, add: Add) -> list[Any]:
    """Return the absolute commands of deltas.

    Args:
        reference: one of REFERENCES except absolute.
        changes: delta of each step.
        state: state at the call.
        command: last command before the call.
        add: returns base + delta.
    """
    base, result = command if reference == "delta_command" else state, []
    for index, change in enumerate(changes):
        result.append(add(base, change, index))
        if reference != "delta_state":
            base = result[-1]
    return result


def deltas_from_commands(reference: str, commands: Sequence[Any], state: Any, command: Any, subtract: Add) -> list[Any]:
    """Return the deltas of absolute commands; the inverse of `commands_from_deltas`.

    Args:
        reference: one of REFERENCES except absolute.
        commands: absolute command of each step.
        state: state at the call.
        command: last command before the call.
        subtract: (base, command, step) -> delta.

    Returns:
        The delta of each step.
    """
    base, result = command if reference == "delta_command" else state, []
    for index, target in enumerate(commands):
        result.append(subtract(base, target, index))
        if reference != "delta_state":
            base = target
    return result


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    block: Block = case.block
    if not block:
        return
    whole = [Site(("action",), block["action"])]
    for reference in REFERENCES:
        yield from mistakes_at_sites(whole, 0, f"reference: {reference}", _NAME, set_key("reference", reference))
    of_parts = [site for site in parts(block, "joints", "hand", "position", "rotation") if site.group == "action"]
    for reference in REFERENCES:
        change = set_key("reference", reference, block["action"]["reference"])
        yield from mistakes_at_sites(of_parts, 1, f"reference of the part: {reference}", _NAME, change)
    yield from mistakes_at_sites(of_parts, 1, "reference of the part: none", _NAME, remove_key("reference"))
    grippers = [site for site in parts(block, "gripper") if site.group == "action"]
    for reference in REFERENCES:
        rank = 1 if reference in ("delta_state", "absolute") else 3
        change = set_key("reference", reference, "absolute")
        yield from mistakes_at_sites(grippers, rank, f"gripper: reference: {reference}", _NAME, change)
    poses = [site for site in parts(block, "position", "rotation") if site.group == "action"]
    for applied in _APPLIED:
        yield from mistakes_at_sites(poses, 0, f"applied: {applied}", _NAME, set_key("applied", applied, "fixed"))


_Chosen = Callable[[str], bool]
_Change = Callable[[Steps, int, Sequence[Obs], Optional["_Command"]], Steps]
"""Changes the fields of an answer's steps, given the index of the observation at the call, all observations, and
the previous command."""


@dataclass(frozen=True)
class _Command:
    """The last command of an answer, before and after the change."""

    original: ArrayMap
    changed: ArrayMap


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    """Yield other references: of arms, since grippers are seldom deltas, of grippers, of all, and of each arm."""
    modes = deltas.frames(case.action_type)
    ages = [age for age in dict.fromkeys((1, (case.history - 1) * case.stride, 2)) if age > 0]

    def mistake(rank: int, words: str, change: _Change, chosen: _Chosen) -> Mistake:
        return Mistake(rank, words, _NAME, change_actions=_change_references(change, chosen))

    for extra_rank, label, chosen in _scopes(case.embodiment):
        for mode in modes:
            changes: list[tuple[int, str, _Change]] = [
                (0, "delta_state, not absolute", _add_state(mode)),
                (0, "the state added once less", _subtract_state(mode)),
                (0, "cumulative, not delta_state", _accumulate(mode)),
                (0, "delta_state, not cumulative", _undo_accumulation(mode)),
                (0, "delta_command, not delta_state", _swap_state_and_command(mode, to_command=True)),
                (0, "delta_state, not delta_command", _swap_state_and_command(mode, to_command=False)),
            ]
            for age in ages:
                words = f"the newest observation, not that {age} step{'' if age == 1 else 's'} before"
                changes.append((1, words, _rebase_from_older(age, mode)))
            if mode == deltas.FRAMES[0] and case.action_type == "joint":
                changes.append((2, "cumulative over the steps, not over the numbers", _accumulate_over_steps))
            for rank, words, change in changes:
                yield mistake(rank + extra_rank, f"reference: {words}{label}", change, chosen)
        applied = itertools.permutations(deltas.APPLIED, 2) if len(modes) > 1 and "gripper" not in label else ()
        for one, other in applied:
            yield mistake(extra_rank, f"applied: {one}, not {other}{label}", _change_frame(other, one), chosen)
    for (one, other), mode in itertools.product(itertools.permutations(case.embodiment.prefixes, 2), modes):
        words = f"reference: the {one.rstrip('_')} arm's own state, not the other's"
        yield mistake(1, words, _rebase_from_arm(one, other, mode), functools.partial(_is_of, one, arm=True))


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


def _change_references(change: _Change, chosen: _Chosen) -> ActionChange:
    def change_actions(
        answers: Sequence[Sequence[ArrayMap]], observations: Sequence[Obs], indices: Sequence[int]
    ) -> list[list[OptionalStep]]:
        result: list[list[OptionalStep]] = []
        last: _Command | None = None
        pending: _Command | None = None
        for index, (steps, call_index) in enumerate(zip(answers, indices)):
            if index and indices[index - 1] != call_index:  # a repeated call has the same base
                last = pending
            moved = change([select_fields(step, chosen) for step in steps], call_index, observations, last)
            result.append([_merge_fields(step, new) for step, new in zip(steps, moved)])
            pending = _Command(select_fields(steps[-1], chosen), moved[-1])
        return result

    return change_actions


def _merge_fields(step: ArrayMap, new: ArrayMap) -> dict[str, np.ndarray]:
    """Return a step with its new fields; a gripper opening that was clipped becomes NaN."""
    result = {**step, **new}
    for key in new:
        value = np.asarray(step[key], np.float64)
        if key.endswith(spec.State.EE_JOINT_STATE) and value.shape == (1,):
            clipped = (value <= spec.GRIPPER_CLOSED) | (value >= spec.GRIPPER_OPEN)
            inside = np.clip(np.asarray(new[key], np.float64), spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN)
            result[key] = np.where(clipped, np.nan, inside)
    return result


def _state(observations: Sequence[Obs], call_index: int) -> ArrayMap:
    state: ArrayMap = observations[call_index][spec.Obs.STATE]
    return state


def _add_state(mode: str) -> _Change:
    return lambda steps, call_index, observations, _last: [
        deltas.apply_differences(step, _state(observations, call_index), mode) for step in steps
    ]


def _subtract_state(mode: str) -> _Change:
    return lambda steps, call_index, observations, _last: [
        deltas.differences(step, _state(observations, call_index), mode) for step in steps
    ]


def _accumulate(mode: str) -> _Change:
    def change(steps: Steps, call_index: int, observations: Sequence[Obs], _last: _Command | None) -> Steps:
        state = _state(observations, call_index)
        return _sum_deltas((deltas.differences(step, state, mode) for step in steps), state, mode)

    return change


def _sum_deltas(changes: Iterable[ArrayMap], base: ArrayMap, mode: str) -> Steps:
    result: Steps = []
    for change in changes:
        base = deltas.apply_differences(change, base, mode)
        result.append(dict(base))
    return result


def _undo_accumulation(mode: str) -> _Change:
    def change(steps: Steps, call_index: int, observations: Sequence[Obs], _last: _Command | None) -> Steps:
        state = _state(observations, call_index)
        bases = [state, *steps[:-1]]
        changes = (deltas.differences(step, base, mode) for step, base in zip(steps, bases))
        return [deltas.apply_differences(one, state, mode) for one in changes]

    return change


def _rebase_from_older(age: int, mode: str) -> _Change:
    """Count from the newest observation what was counted from an older one."""

    def change(steps: Steps, call_index: int, observations: Sequence[Obs], _last: _Command | None) -> Steps:
        true, other = _state(observations, call_index), _state(observations, max(0, call_index - age))
        return [deltas.apply_differences(deltas.differences(step, other, mode), true, mode) for step in steps]

    return change


def _rebase_from_arm(one: str, other: str, mode: str) -> _Change:
    """Count from an arm's own state what was counted from the other's."""

    def change(steps: Steps, call_index: int, observations: Sequence[Obs], _last: _Command | None) -> Steps:
        true = _state(observations, call_index)
        taken = {key: true[other + key.removeprefix(one)] for key in true if key.startswith(one)}
        return [deltas.apply_differences(deltas.differences(step, taken, mode), true, mode) for step in steps]

    return change


def _accumulate_over_steps(steps: Steps, call_index: int, observations: Sequence[Obs], _last: _Command | None) -> Steps:
    """Add up over the steps what was added up over the numbers of each."""
    state = _state(observations, call_index)
    apart = [deltas.differences(step, state, deltas.FRAMES[0]) for step in steps]
    single = [{key: np.diff(value, prepend=0.0) for key, value in step.items()} for step in apart]
    return _sum_deltas(single, state, deltas.FRAMES[0])


def _change_frame(adapter_frame: str, model_frame: str) -> _Change:
    """Apply a change of pose in another frame than the adapter did."""

    def change(steps: Steps, call_index: int, observations: Sequence[Obs], _last: _Command | None) -> Steps:
        state = _state(observations, call_index)
        return [
            deltas.apply_differences(deltas.differences(step, state, adapter_frame), state, model_frame)
            for step in steps
        ]

    return change


def _swap_state_and_command(mode: str, *, to_command: bool) -> _Change:
    """Count from the command before what was counted from the state at the call, or the other way round."""

    def change(steps: Steps, call_index: int, observations: Sequence[Obs], last: _Command | None) -> Steps:
        state = _state(observations, call_index)
        if to_command:
            start = state if last is None else last.changed
            return _sum_deltas((deltas.differences(step, state, mode) for step in steps), start, mode)
        bases = [state if last is None else last.original, *steps[:-1]]
        changes = (deltas.differences(step, base, mode) for step, base in zip(steps, bases))
        return [deltas.apply_differences(one, state, mode) for one in changes]

    return change


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    keys={
        group: ["reference", "applied"] for group in ("vectors", "joints", "hand", "gripper", "position", "rotation")
    },
    applies=lambda _block: True,
)
