"""Changes of the fields of an arm: there and back, what they do to differences, and each as mistakes of an adapter.

A change is tried on its ways: in what is shown, in what is commanded, in both; of values and of differences.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import deltas
from xpl.catalogue.mistake import Case, Commanded, Episode, Given, Mistake, Obs, Shown, Step
from xpl.contract import State

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from xpl.embodiment import Embodiment

Numbers = np.ndarray[Any, np.dtype[Any]]

_POSES = (spec.State.EE_POSE, spec.State.TCP_POSE)
Fields = State
"""The map `state` of an observation, or an action step."""
Turn = Callable[[Fields], dict[str, Numbers]]
Function = Callable[[Numbers], Numbers]


@dataclass(frozen=True)
class Change:
    """Another way to write the fields of an arm.

    Attributes:
        rank: 0 for the likeliest.
        words: what the model means.
        convention: of the vocabulary.
        there: the standard's fields as the model writes them.
        back: the inverse.
        delta: `back` of differences; None where differences have no such way.
        ways: which ways are tried: state, action, both.
    """

    rank: int
    words: str
    convention: str
    there: Turn
    back: Turn
    delta: Turn | None
    ways: tuple[str, ...] = ("both", "state", "action")

    def inverse(self, words: str, delta: Turn | None = None) -> Change:
        """Return the change in the other direction."""
        return replace(self, words=words, there=self.back, back=self.there, delta=delta)


def on(keys: Iterable[str], function: Function) -> Turn:
    """Return the change of these fields, where they are there, by a function of (..., width) float64."""
    chosen = frozenset(keys)

    def turn(fields: Fields) -> dict[str, Numbers]:
        return {key: _like(value, function) if key in chosen else value for key, value in fields.items()}

    return turn


def _like(value: Any, function: Function) -> Numbers:
    array = np.asarray(value)
    result = function(array.astype(np.float64))
    return result.astype(array.dtype) if array.dtype.kind == "f" else result


def exchanged(pairs: Mapping[str, str]) -> Turn:
    """Return the change that gives fields each other's values."""

    def turn(fields: Fields) -> dict[str, Numbers]:
        other = {**pairs, **{value: key for key, value in pairs.items()}}
        return {key: fields.get(other.get(key, key), value) for key, value in fields.items()}

    return turn


_PLACE, _TURN = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)


def poses(prefixes: Iterable[str]) -> list[str]:
    """Return the fields of arms that are poses."""
    return [prefix + key for prefix in prefixes for key in _POSES]


def turned(function: Function) -> Function:
    """Return the change of poses (..., 7) that changes their quaternions."""
    return lambda pose: np.concatenate((pose[..., _PLACE], function(pose[..., _TURN])), axis=-1)


def placed(function: Function) -> Function:
    """Return the change of poses (..., 7) that changes their positions."""
    return lambda pose: np.concatenate((function(pose[..., _PLACE]), pose[..., _TURN]), axis=-1)


def whole(function: Function) -> Function:
    """Return the change of poses that changes all of them."""
    return function


def _position(function: Function) -> Function:
    return lambda pose: np.concatenate((function(pose)[..., _PLACE], pose[..., _TURN]), axis=-1)


def _rotation(function: Function) -> Function:
    return lambda pose: np.concatenate((pose[..., _PLACE], function(pose)[..., _TURN]), axis=-1)


PARTS: tuple[tuple[int, str, Callable[[Function], Function]], ...] = (
    (0, "", whole),
    (1, " of the position", _position),
    (1, " of the rotation", _rotation),
)
"""What of a pose is changed: how much later it is tried, how it is called, and the change of poses that does so."""


def linear(  # noqa: PLR0913, PLR0917 - one line of numbers
    rank: int, words: str, convention: str, keys: Iterable[str], scale: float, offset: float = 0.0
) -> Change:
    """Return the change to ``scale * x + offset``."""
    return Change(
        rank,
        words,
        convention,
        on(keys, lambda values: values * scale + offset),
        on(keys, lambda values: (values - offset) / scale),
        on(keys, lambda values: values / scale),
    )


def sides(rank: int, words: str, convention: str, names: Sequence[str], embodiment: Embodiment) -> Iterator[Change]:
    """Yield the exchange of left and right in some fields, where there are two arms."""
    if len(embodiment.prefixes) == 2:
        one, other = embodiment.prefixes
        turn = exchanged({one + name: other + name for name in names})
        yield Change(rank, f"{words}: left and right exchanged", convention, turn, turn, turn)


def same(fields: Fields) -> dict[str, Numbers]:
    """Change nothing."""
    return dict(fields)


def scopes(prefixes: Sequence[str]) -> list[tuple[int, str, tuple[str, ...]]]:
    """Return all arms together, then each alone: how much later it is tried, how it is called, its prefixes."""
    found = [(0, "", tuple(prefixes))]
    if len(prefixes) > 1:
        found += [(1, f" {prefix.rstrip('_')}", (prefix,)) for prefix in prefixes]
    return found


More = Callable[[Obs], Obs]
"""A change of an observation besides that of its state, such as that of the wrist cameras."""


def mistakes(change: Change, case: Case, more: More | None = None) -> Iterator[Mistake]:
    """Yield the ways of a change that have a meaning: for what the adapter reads, and for what it commands."""
    shown = _shown(change.there, more)
    action_type, dims = case.action_type, case.embodiment.dims(case.action_type)
    commands = _touches(change, dims)
    if not _touches(change, _shape_of(case.embodiment, case.reads)):
        change = replace(change, ways=tuple(way for way in change.ways if way == "action"))
    modes = deltas.modes(action_type)
    if "state" in change.ways:
        words = f"{change.words} (state)" if commands else change.words
        yield Mistake(change.rank, words, change.convention, shown=shown)
        for mode in modes:
            moved = _delta(change.there, same, mode)
            yield Mistake(change.rank, words, change.convention, shown=shown, commanded=moved)
    if not commands:
        return
    if "action" in change.ways:
        words = f"{change.words} (action)"
        yield Mistake(change.rank, words, change.convention, commanded=_each(change.back))
        for mode in modes if change.delta else ():
            moved = _delta(same, change.delta or same, mode)
            yield Mistake(change.rank, words, change.convention, commanded=moved)
    if "both" in change.ways:
        yield Mistake(change.rank, change.words, change.convention, shown=shown, commanded=_each(change.back))
        for mode in modes if change.delta else ():
            moved = _delta(change.there, change.delta or same, mode)
            yield Mistake(change.rank, change.words, change.convention, shown=shown, commanded=moved)


def rebased(shown: Shown, action_type: str) -> Iterator[Commanded]:
    """Yield what commands become that were counted from the last state that was shown, and count from the true one."""
    for mode in deltas.modes(action_type):
        yield _from_shown(shown, mode)


def _from_shown(shown: Shown, mode: str) -> Commanded:
    def commanded(
        answers: Sequence[Sequence[Given]], observations: Sequence[Obs], asked: Sequence[int]
    ) -> list[list[Step]]:
        result: list[list[Step]] = []
        for steps, place in zip(answers, asked):
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
        for steps, place in zip(answers, asked):
            true = observations[place][spec.Obs.STATE]
            seen = there(true)
            moved = (turn(deltas.apart(step, seen, mode)) for step in steps)
            result.append([deltas.together(change, true, mode) for change in moved])
        return result

    return commanded
