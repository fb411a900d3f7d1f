"""Frame of poses, and unit of lengths. Source: spec/v1/model_io.schema.json#/$defs/frame."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Callable

import numpy as np

from xpl import _spec as spec
from xpl import poses, rotation
from xpl.catalogue import AdapterCase, Convention, Mistake, fields
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import copy_between_state_and_action, mistakes_at_sites, parts, set_key
from xpl.catalogue.fields import FieldChange, Fields, FieldsFunction, Function, Numbers, map_fields
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl.embodiment import Embodiment

_NAME = "frame"
_POSITION, _ROTATION = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)

FRAMES = ("world", "base")
UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
"""What a metre is in each unit."""


def mount(embodiment: Embodiment, side: str) -> np.ndarray:
    """Return the pose (7,) of an arm's base in the world; a single arm stands midway between the mounts of two.

    Raises:
        ConversionError: if the standard does not know it for this robot.
    """
    mounts = embodiment.data.get("mounts")
    if not mounts:
        raise ConversionError(f"the standard does not know where {embodiment.name} is mounted; say frame: world")
    # Written with seven digits, and every pose goes through them.
    turns = {name: rotation.normalise(entry["quaternion"]) for name, entry in mounts.items()}
    if side in mounts:
        return poses.pose(mounts[side]["xyz"], turns[side])
    turn = next(iter(turns.values()))
    if any(not np.allclose(turn, other) for other in turns.values()):
        raise ConversionError(f"the mounts of {embodiment.name} are turned differently; say frame: world")
    return poses.pose(np.mean([entry["xyz"] for entry in mounts.values()], axis=0), turn)


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    if not case.block:
        return
    for frame in reversed(FRAMES):
        change = set_key("frame", frame, FRAMES[0])
        yield from mistakes_at_sites(parts(case.block, "position", "rotation"), 0, f"frame: {frame}", _NAME, change)
    for unit in UNITS:
        change = set_key("unit", unit, "m")
        yield from mistakes_at_sites(parts(case.block, "position"), 1, f"position unit: {unit}", _NAME, change)
    yield from copy_between_state_and_action(case.block, ["rotation", "position"], "frame", _NAME)
    yield from copy_between_state_and_action(case.block, ["position"], "unit", _NAME)


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for extra_rank, label, prefixes in fields.arm_scopes(case.embodiment.prefixes):
        for change in _axis_changes(fields.pose_fields(prefixes), label):
            yield from fields.field_mistakes(replace(change, rank=change.rank + extra_rank), case)
    whole = (spec.State.EE_POSE, spec.State.TCP_POSE, spec.State.DELTA_EE_POSE)
    for change in (*fields.swap_sides(1, "poses", _NAME, whole, case.embodiment), *_frame_changes(case.embodiment)):
        yield from fields.field_mistakes(change, case)


def _axis_changes(keys: Sequence[str], label: str) -> Iterator[FieldChange]:
    """Yield positions in other units, and those whose axes are exchanged, or point the other way."""
    for unit, factor in UNITS.items():
        if factor != 1.0:
            there, back = (
                map_fields(keys, fields.map_positions(partial(np.multiply, one))) for one in (factor, 1 / factor)
            )
            yield FieldChange(1, f"position{label}: in {unit}", _NAME, there, back, back)
            yield FieldChange(1, f"position{label}: in m, not {unit}", _NAME, back, there, there)
    for one, other in itertools.combinations(range(spec.POSITION_DIM), 2):
        order = list(range(spec.POSITION_DIM))
        order[one], order[other] = other, one
        turn = map_fields(keys, fields.map_positions(partial(np.take, indices=order, axis=-1)))
        yield FieldChange(1, f"position{label}: {'xyz'[one]} and {'xyz'[other]} exchanged", _NAME, turn, turn, turn)
    for axis in range(spec.POSITION_DIM):
        signs = np.where(np.arange(spec.POSITION_DIM) == axis, -1.0, 1.0)
        turn = map_fields(keys, fields.map_positions(partial(np.multiply, signs)))
        yield FieldChange(2, f"position{label}: {'xyz'[axis]} the other way", _NAME, turn, turn, turn)


def _frame_changes(embodiment: Embodiment) -> Iterator[FieldChange]:
    mounts = _mounts(embodiment)
    if not mounts:
        return
    for extra_rank, label, only in fields.PARTS:
        inward, outward = (
            _change_arms(mounts, _transform_pose, only, inverse=True),
            _change_arms(mounts, _transform_pose, only, inverse=False),
        )
        into, out = (
            _change_arms(mounts, _transform_delta, only, inverse=True),
            _change_arms(mounts, _transform_delta, only, inverse=False),
        )
        change = FieldChange(extra_rank, f"frame{label}: base", _NAME, inward, outward, out)
        yield change
        yield change.inverse(f"frame{label}: world, not base", into)
    yield from _base_changes(mounts)


def _base_changes(mounts: dict[str, Numbers]) -> Iterator[FieldChange]:
    """Yield bases that stand turned otherwise, or elsewhere: what is left of a frame that was taken off by half."""
    places = {prefix: _translation(mount[_POSITION]) for prefix, mount in mounts.items()}
    turns = {prefix: _pure_rotation(mount[_ROTATION]) for prefix, mount in mounts.items()}
    for rank, words, count in (
        (1, "turned the other way", -2),
        (1, "not turned", -1),
        (2, "turned", 1),
        (2, "turned twice", 2),
    ):
        about = {prefix: _rotation_about(places[prefix], turns[prefix], count) for prefix in mounts}
        yield _base_change(rank, f"base: {words}", about)
    for rank, words, share in ((1, "place taken off before the turn", 1), (2, "place taken off after the turn", -1)):
        moved = {
            prefix: _translation(share * (rotation.rotate(mount[_ROTATION], mount[_POSITION]) - mount[_POSITION]))
            for prefix, mount in mounts.items()
        }
        yield _base_change(rank, f"base: {words}", moved)
    for words, share in (("place taken off", -1), ("place not taken off", 1)):
        yield _base_change(
            2, f"base: {words}", {prefix: _translation(share * mounts[prefix][_POSITION]) for prefix in mounts}
        )


def _base_change(rank: int, words: str, transforms: dict[str, Numbers]) -> FieldChange:
    there, back = (
        _change_arms(transforms, _transform_pose, fields.map_poses, inverse=inverse) for inverse in (False, True)
    )
    return FieldChange(rank, words, _NAME, there, back, None)


def _translation(position: Numbers) -> Numbers:
    return np.concatenate((position, rotation.identity()))


def _pure_rotation(turn: Numbers) -> Numbers:
    return np.concatenate((np.zeros(spec.POSITION_DIM), turn))


def _rotation_about(center: Numbers, turn: Numbers, count: int) -> Numbers:
    """Return a turn about a place, applied so many times, backwards if below zero."""
    once = turn if count > 0 else poses.invert(turn)
    outer = center
    for _ in range(abs(count)):
        outer = poses.compose(outer, once)
    return poses.compose(outer, poses.invert(center))


def _mounts(embodiment: Embodiment) -> dict[str, Numbers]:
    """Return the pose of each arm's base in the world; none where the standard does not know them."""
    try:
        return {arm.prefix: mount(embodiment, side) for arm, side in zip(embodiment.arms, embodiment.data["arms"])}
    except ConversionError:
        return {}


def _change_arms(
    mounts: dict[str, Numbers],
    moved: Callable[[Numbers, Numbers], Numbers],
    only: Callable[[Function], Function],
    *,
    inverse: bool,
) -> FieldsFunction:
    """Return the change of each arm's poses, or of differences of them, from its base to the world, or back."""
    turns = {}
    for prefix, one in mounts.items():
        outer = poses.invert(one) if inverse else one
        turns.update(dict.fromkeys(fields.pose_fields([prefix]), only(partial(moved, outer))))

    def turn(state: Fields) -> dict[str, Numbers]:
        result = dict(state)
        for key in turns.keys() & state.keys():
            result.update(map_fields([key], turns[key])({key: state[key]}))
        return result

    return turn


def _transform_pose(outer: Numbers, pose: Numbers) -> Numbers:
    return poses.compose(outer, pose)


def _transform_delta(outer: Numbers, change: Numbers) -> Numbers:
    turn = outer[_ROTATION]
    moved = rotation.rotate(turn, change[..., _POSITION])
    turned = rotation.multiply(rotation.multiply(turn, change[..., _ROTATION]), rotation.conjugate(turn))
    return np.concatenate((moved, turned), axis=-1)


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    keys={"position": ["frame", "unit"], "rotation": ["frame"]},
    applies=lambda block: bool({"position", "rotation"} & kinds(block)),
)
