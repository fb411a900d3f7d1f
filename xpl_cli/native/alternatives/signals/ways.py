"""Each change of fields on its ways: in what is shown, in what is commanded, in both; of values and of differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl_cli.native.alternatives.signals import deltas
from xpl_cli.native.alternatives.signals.fields import Change, Turn, same
from xpl_cli.native.alternatives.signals.signal import Commanded, Obs, Shown, Signal, Step

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

More = Callable[[Obs], Obs]
"""A change of an observation besides that of its state, such as that of the wrist cameras."""


def signals(change: Change, embodiment: Embodiment, action_type: str, more: More | None = None) -> Iterator[Signal]:
    """Yield the ways of a change; where it cannot touch what is commanded, only that of what is shown."""
    shown = _shown(change.there, more)
    commands = _touches(change, embodiment, action_type)
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
        answers: Sequence[Sequence[Mapping[str, Any]]], observations: Sequence[Obs], asked: Sequence[int]
    ) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked, strict=True):
            true = observations[place][spec.Obs.STATE]
            seen = shown(observations[: place + 1])[-1][spec.Obs.STATE]
            result.append([deltas.together(deltas.apart(step, seen, mode), true, mode) for step in steps])
        return result

    return commanded


def _touches(change: Change, embodiment: Embodiment, action_type: str) -> bool:
    """Tell whether a change has a meaning for the keys of an action."""
    zero = {key: _some(width, deltas.is_pose(key)) for key, width in embodiment.dims(action_type).items()}
    return any((change.there(zero)[key] != value).any() for key, value in zero.items())


def _some(width: int, is_pose: bool) -> Any:  # noqa: FBT001 - what the key tells
    import numpy as np

    values = np.random.default_rng(width).uniform(0.2, 0.8, width)
    if is_pose:
        values[spec.POSITION_DIM :] /= np.linalg.norm(values[spec.POSITION_DIM :])
        values[spec.POSITION_DIM :] *= -1.0
    return values


def _shown(turn: Turn, more: More | None) -> Shown:
    def shown(observations: Sequence[Obs]) -> list[dict[str, Any]]:
        changed = [{**obs, spec.Obs.STATE: turn(obs.get(spec.Obs.STATE) or {})} for obs in observations]
        return [dict(obs if more is None else more(obs)) for obs in changed]

    return shown


def _each(turn: Turn) -> Commanded:
    def commanded(
        answers: Sequence[Sequence[Mapping[str, Any]]], _observations: Sequence[Obs], _asked: Sequence[int]
    ) -> list[list[Step]]:
        return [[turn(step) for step in steps] for steps in answers]

    return commanded


def _delta(there: Turn, turn: Turn, mode: str) -> Commanded:
    """Return what commands become whose difference to the state that was shown is changed, and counts from the true."""

    def commanded(
        answers: Sequence[Sequence[Mapping[str, Any]]], observations: Sequence[Obs], asked: Sequence[int]
    ) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked, strict=True):
            true = observations[place][spec.Obs.STATE]
            seen = there(true)
            moved = (turn(deltas.apart(step, seen, mode)) for step in steps)
            result.append([deltas.together(change, true, mode) for change in moved])
        return result

    return commanded
