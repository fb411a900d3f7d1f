"""Each change of fields on its ways: in what is shown, in what is commanded, in both; of values and of differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl_cli.model_io.alternatives.signals import deltas
from xpl_cli.model_io.alternatives.signals.fields import Change, Turn, same
from xpl_cli.model_io.alternatives.signals.signal import Commanded, Episode, Given, Obs, Shown, Signal, Step

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

_POSES = (spec.State.EE_POSE, spec.State.TCP_POSE)

More = Callable[[Obs], Obs]
"""A change of an observation besides that of its state, such as that of the wrist cameras."""


def signals(
    change: Change,
    embodiment: Embodiment,
    action_type: str,
    reads: Sequence[str] | None = None,
    more: More | None = None,
) -> Iterator[Signal]:
    """Yield the ways of a change that have a meaning: for what the adapter reads, and for what it commands."""
    shown = _shown(change.there, more)
    dims = embodiment.dims(action_type)
    commands = _touches(change, dims)
    if not _touches(change, _shape_of(embodiment, reads)):
        change = replace(change, ways=tuple(way for way in change.ways if way == "action"))
    modes = deltas.MODES if action_type == "ee" else deltas.MODES[:1]
    if "state" in change.ways:
        words = f"{change.words} (state)" if commands else change.words
        yield Signal(change.rank, words, change.convention, shown)
        for mode in modes:
            moved = _delta(change.there, same, mode)
            yield Signal(change.rank, words, change.convention, shown, moved)
    if not commands:
        return
    if "action" in change.ways:
        words = f"{change.words} (action)"
        yield Signal(change.rank, words, change.convention, None, _each(change.back))
        for mode in modes if change.delta else ():
            moved = _delta(same, change.delta or same, mode)
            yield Signal(change.rank, words, change.convention, None, moved)
    if "both" in change.ways:
        yield Signal(change.rank, change.words, change.convention, shown, _each(change.back))
        for mode in modes if change.delta else ():
            moved = _delta(change.there, change.delta or same, mode)
            yield Signal(change.rank, change.words, change.convention, shown, moved)


def rebased(shown: Shown, action_type: str) -> Iterator[Commanded]:
    """Yield what commands become that were counted from the last state that was shown, and count from the true one."""
    for mode in deltas.MODES if action_type == "ee" else deltas.MODES[:1]:
        yield _from_shown(shown, mode)


def _from_shown(shown: Shown, mode: str) -> Commanded:
    def commanded(
        answers: Sequence[Sequence[Given]], observations: Sequence[Obs], asked: Sequence[int]
    ) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked, strict=True):
            true = observations[place][spec.Obs.STATE]
            seen = shown(observations[: place + 1])[-1][spec.Obs.STATE]
            result.append([deltas.together(deltas.apart(step, seen, mode), true, mode) for step in steps])
        return result

    return commanded


def _shape_of(embodiment: Embodiment, reads: Sequence[str] | None) -> dict[str, int]:
    """Return the fields of a state that an adapter reads, all if it is not known which."""
    return {
        arm.prefix + name: width
        for arm in embodiment.arms
        for name, width in (
            (spec.State.ARM_JOINT_STATE, arm.dof),
            (spec.State.EE_JOINT_STATE, arm.ee_dim),
            *((pose, spec.POSE_DIM) for pose in _POSES),
        )
        if reads is None or name in reads
    }


def _touches(change: Change, widths: Mapping[str, int]) -> bool:
    """Tell whether a change has a meaning for these fields."""
    some = {key: _some(key, width) for key, width in widths.items()}
    return any((change.there(some)[key] != value).any() for key, value in some.items())


def _some(key: str, width: int) -> Any:
    values: Any = np.random.default_rng([width, len(key)]).uniform(0.2, 0.8, width)
    if key.endswith(_POSES):
        values[spec.POSITION_DIM :] /= np.linalg.norm(values[spec.POSITION_DIM :])
        values[spec.POSITION_DIM :] *= -1.0
    return values


def _shown(turn: Turn, more: More | None) -> Shown:
    def shown(observations: Sequence[Obs]) -> Episode:
        changed = [{**obs, spec.Obs.STATE: turn(obs.get(spec.Obs.STATE) or {})} for obs in observations]
        return [dict(obs if more is None else more(obs)) for obs in changed]

    return shown


def _each(turn: Turn) -> Commanded:
    def commanded(
        answers: Sequence[Sequence[Given]], _observations: Sequence[Obs], _asked: Sequence[int]
    ) -> list[list[Step]]:
        return [[turn(step) for step in steps] for steps in answers]

    return commanded


def _delta(there: Turn, turn: Turn, mode: str) -> Commanded:
    """Return what commands become whose difference to the state that was shown is changed, and counts from the true."""

    def commanded(
        answers: Sequence[Sequence[Given]], observations: Sequence[Obs], asked: Sequence[int]
    ) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked, strict=True):
            true = observations[place][spec.Obs.STATE]
            seen = there(true)
            moved = (turn(deltas.apart(step, seen, mode)) for step in steps)
            result.append([deltas.together(change, true, mode) for change in moved])
        return result

    return commanded
