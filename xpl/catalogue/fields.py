"""Changes of the fields of an arm, their inverses and their effect on deltas, and the mistakes that they make.

A change is tried on its targets: observations, actions, both; on values and on deltas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl.catalogue import deltas
from xpl.catalogue.mistake import (
    ActionChange,
    AdapterCase,
    ArrayMap,
    Mistake,
    Obs,
    ObservationChange,
    ObservationList,
    OptionalStep,
)
from xpl.contract import State

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from xpl.embodiment import Embodiment

Numbers = np.ndarray[Any, np.dtype[Any]]

_POSES = (spec.State.EE_POSE, spec.State.TCP_POSE)
Fields = State
"""The map `state` of an observation, or an action step."""
FieldsFunction = Callable[[Fields], dict[str, Numbers]]
Function = Callable[[Numbers], Numbers]


@dataclass(frozen=True)
class FieldChange:
    """Another representation of the fields of an arm.

    Attributes:
        rank: 0 for the likeliest.
        description: what the model expects.
        convention: name of its convention.
        to_model: from the standard's fields to the model's.
        to_standard: the inverse.
        delta_to_standard: `to_standard` of deltas; None if deltas have no such form.
        targets: what is changed: state, action, both.
    """

    rank: int
    description: str
    convention: str
    to_model: FieldsFunction
    to_standard: FieldsFunction
    delta_to_standard: FieldsFunction | None
    targets: tuple[str, ...] = ("both", "state", "action")

    def inverse(self, words: str, delta: FieldsFunction | None = None) -> FieldChange:
        """Return the change in the other direction."""
        return replace(
            self, description=words, to_model=self.to_standard, to_standard=self.to_model, delta_to_standard=delta
        )


def map_fields(keys: Iterable[str], function: Function) -> FieldsFunction:
    """Return the change of these fields, where present, by a function of (..., width) float64."""
    chosen = frozenset(keys)

    def turn(fields: Fields) -> dict[str, Numbers]:
        return {key: _like(value, function) if key in chosen else value for key, value in fields.items()}

    return turn


def _like(value: Any, function: Function) -> Numbers:
    array = np.asarray(value)
    result = function(array.astype(np.float64))
    return result.astype(array.dtype) if array.dtype.kind == "f" else result


def swap_fields(pairs: Mapping[str, str]) -> FieldsFunction:
    """Return the change that exchanges the values of pairs of fields."""

    def turn(fields: Fields) -> dict[str, Numbers]:
        other = {**pairs, **{value: key for key, value in pairs.items()}}
        return {key: fields.get(other.get(key, key), value) for key, value in fields.items()}

    return turn


_POSITION, _ROTATION = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)


def pose_fields(prefixes: Iterable[str]) -> list[str]:
    """Return the pose fields of arms."""
    return [prefix + key for prefix in prefixes for key in _POSES]


def map_rotations(function: Function) -> Function:
    """Return the change of poses (..., 7) that changes their quaternions."""
    return lambda pose: np.concatenate((pose[..., _POSITION], function(pose[..., _ROTATION])), axis=-1)


def map_positions(function: Function) -> Function:
    """Return the change of poses (..., 7) that changes their positions."""
    return lambda pose: np.concatenate((function(pose[..., _POSITION]), pose[..., _ROTATION]), axis=-1)


def map_poses(function: Function) -> Function:
    """Return the change of poses that changes all of them."""
    return function


def _position(function: Function) -> Function:
    return lambda pose: np.concatenate((function(pose)[..., _POSITION], pose[..., _ROTATION]), axis=-1)


def _rotation(function: Function) -> Function:
    return lambda pose: np.concatenate((pose[..., _POSITION], function(pose)[..., _ROTATION]), axis=-1)


PARTS: tuple[tuple[int, str, Callable[[Function], Function]], ...] = (
    (0, "", map_poses),
    (1, " of the position", _position),
    (1, " of the rotation", _rotation),
)
"""Components of a pose that are changed: additional rank, suffix of the description, and the change of poses."""


def linear(  # noqa: PLR0913, PLR0917 - one line of numbers
    rank: int, words: str, convention: str, keys: Iterable[str], scale: float, offset: float = 0.0
) -> FieldChange:
    """Return the change of fields to ``scale * x + offset``; deltas are scaled only.

    Args:
        rank: 0 for the likeliest.
        words: what the model expects.
        convention: name of the change's convention.
        keys: keys of the fields; absent ones are skipped.
        scale: factor from the standard's values to the model's, not 0.
        offset: summand, in the model's unit.
    """
    return FieldChange(
        rank,
        words,
        convention,
        map_fields(keys, lambda values: values * scale + offset),
        map_fields(keys, lambda values: (values - offset) / scale),
        map_fields(keys, lambda values: values / scale),
    )


def swap_sides(
    rank: int, words: str, convention: str, names: Sequence[str], embodiment: Embodiment
) -> Iterator[FieldChange]:
    """Yield the exchange of left and right in some fields; nothing for a robot of one arm.

    Args:
        rank: 0 for the likeliest.
        words: what is exchanged, as the beginning of the description.
        convention: name of the change's convention.
        names: names of the fields, without an arm's prefix.
        embodiment: the robot.
    """
    if len(embodiment.prefixes) == 2:
        one, other = embodiment.prefixes
        turn = swap_fields({one + name: other + name for name in names})
        yield FieldChange(rank, f"{words}: left and right exchanged", convention, turn, turn, turn)


def identity(fields: Fields) -> dict[str, Numbers]:
    """Change nothing."""
    return dict(fields)


def arm_scopes(prefixes: Sequence[str]) -> list[tuple[int, str, tuple[str, ...]]]:
    """Return all arms together, then each alone: additional rank, suffix of the description, prefixes."""
    scopes = [(0, "", tuple(prefixes))]
    if len(prefixes) > 1:
        scopes += [(1, f" {prefix.rstrip('_')}", (prefix,)) for prefix in prefixes]
    return scopes


ExtraChange = Callable[[Obs], Obs]
"""A change of an observation in addition to its state, such as of the wrist cameras."""


def field_mistakes(change: FieldChange, case: AdapterCase, extra: ExtraChange | None = None) -> Iterator[Mistake]:
    """Yield the mistakes of a change that apply to what the adapter reads and to its actions.

    Each target of the change is tried on absolute values and on deltas in every frame of the action type. Targets with
    the state are left out if the change has no effect on what the adapter reads, those with actions if it has none on
    the fields of an action.

    Args:
        change: the change of an arm's fields.
        case: the adapter.
        extra: additional change of an observation, after that of its state.
    """
    change_observations = _change_state(change.to_model, extra)
    action_type, dims = case.action_type, case.embodiment.dims(case.action_type)
    commands = _has_effect(change, dims)
    if not _has_effect(change, _field_widths(case.embodiment, case.reads)):
        change = replace(change, targets=tuple(target for target in change.targets if target == "action"))
    modes = deltas.frames(action_type)
    if "state" in change.targets:
        words = f"{change.description} (state)" if commands else change.description
        yield Mistake(change.rank, words, change.convention, change_observations=change_observations)
        for mode in modes:
            moved = _map_differences(change.to_model, identity, mode)
            yield Mistake(
                change.rank, words, change.convention, change_observations=change_observations, change_actions=moved
            )
    if not commands:
        return
    if "action" in change.targets:
        words = f"{change.description} (action)"
        yield Mistake(change.rank, words, change.convention, change_actions=_map_actions(change.to_standard))
        for mode in modes if change.delta_to_standard else ():
            moved = _map_differences(identity, change.delta_to_standard or identity, mode)
            yield Mistake(change.rank, words, change.convention, change_actions=moved)
    if "both" in change.targets:
        yield Mistake(
            change.rank,
            change.description,
            change.convention,
            change_observations=change_observations,
            change_actions=_map_actions(change.to_standard),
        )
        for mode in modes if change.delta_to_standard else ():
            moved = _map_differences(change.to_model, change.delta_to_standard or identity, mode)
            yield Mistake(
                change.rank,
                change.description,
                change.convention,
                change_observations=change_observations,
                change_actions=moved,
            )


def rebase_actions(change_observations: ObservationChange, action_type: str) -> Iterator[ActionChange]:
    """Yield changes of delta actions from the state that the adapter was sent last to the true state."""
    for mode in deltas.frames(action_type):
        yield _rebase_in_frame(change_observations, mode)


def _rebase_in_frame(shown: ObservationChange, mode: str) -> ActionChange:
    def commanded(
        answers: Sequence[Sequence[ArrayMap]], observations: Sequence[Obs], asked: Sequence[int]
    ) -> list[list[OptionalStep]]:
        result: list[list[OptionalStep]] = []
        for steps, place in zip(answers, asked):
            true = observations[place][spec.Obs.STATE]
            seen = shown(observations[: place + 1])[-1][spec.Obs.STATE]
            result.append(
                [deltas.apply_differences(deltas.differences(step, seen, mode), true, mode) for step in steps]
            )
        return result

    return commanded


def _field_widths(embodiment: Embodiment, reads: Sequence[str] | None) -> dict[str, int]:
    """Return the widths of the fields of a state that an adapter reads; of all if that is unknown."""
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


def _has_effect(change: FieldChange, widths: Mapping[str, int]) -> bool:
    """Return whether a change has an effect on these fields."""
    some = {key: _example_values(key, width) for key, width in widths.items()}
    return any((change.to_model(some)[key] != value).any() for key, value in some.items())


def _example_values(key: str, width: int) -> Any:
    values: Any = np.random.default_rng([width, len(key)]).uniform(0.2, 0.8, width)
    if key.endswith(_POSES):
        values[spec.POSITION_DIM :] /= np.linalg.norm(values[spec.POSITION_DIM :])
        values[spec.POSITION_DIM :] *= -1.0
    return values


def _change_state(turn: FieldsFunction, more: ExtraChange | None) -> ObservationChange:
    def change(observations: Sequence[Obs]) -> ObservationList:
        changed = [{**obs, spec.Obs.STATE: turn(obs.get(spec.Obs.STATE) or {})} for obs in observations]
        return [dict(obs if more is None else more(obs)) for obs in changed]

    return change


def _map_actions(turn: FieldsFunction) -> ActionChange:
    def commanded(
        answers: Sequence[Sequence[ArrayMap]], _observations: Sequence[Obs], _asked: Sequence[int]
    ) -> list[list[OptionalStep]]:
        return [[turn(step) for step in steps] for steps in answers]

    return commanded


def _map_differences(there: FieldsFunction, turn: FieldsFunction, mode: str) -> ActionChange:
    """Return the change of actions whose delta to the state sent is changed and applied to the true state."""

    def commanded(
        answers: Sequence[Sequence[ArrayMap]], observations: Sequence[Obs], asked: Sequence[int]
    ) -> list[list[OptionalStep]]:
        result: list[list[OptionalStep]] = []
        for steps, place in zip(answers, asked):
            true = observations[place][spec.Obs.STATE]
            seen = there(true)
            moved = (turn(deltas.differences(step, seen, mode)) for step in steps)
            result.append([deltas.apply_differences(change, true, mode) for change in moved])
        return result

    return commanded
