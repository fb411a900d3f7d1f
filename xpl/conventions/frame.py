"""Frame of poses, and unit of lengths. Source: spec/v1/model_io.schema.json#/$defs/frame."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Callable

import numpy as np

from xpl import _spec as spec
from xpl import poses, rotation
from xpl.catalogue import Case, Convention, Mistake, fields
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import alike, everywhere, parts, word
from xpl.catalogue.fields import Change, Fields, Function, Numbers, Turn, on
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl.embodiment import Embodiment

_NAME = "frame"
_PLACE, _TURN = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)

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


def _in_block(case: Case) -> Iterator[Mistake]:
    if not case.block:
        return
    for frame in reversed(FRAMES):
        change = word("frame", frame, FRAMES[0])
        yield from everywhere(parts(case.block, "position", "rotation"), 0, f"frame: {frame}", _NAME, change)
    for unit in UNITS:
        change = word("unit", unit, "m")
        yield from everywhere(parts(case.block, "position"), 1, f"position unit: {unit}", _NAME, change)
    yield from alike(case.block, ["rotation", "position"], "frame", _NAME)
    yield from alike(case.block, ["position"], "unit", _NAME)


def _around(case: Case) -> Iterator[Mistake]:
    for later, told, prefixes in fields.scopes(case.embodiment.prefixes):
        for change in _numbers(fields.poses(prefixes), told):
            yield from fields.mistakes(replace(change, rank=change.rank + later), case)
    whole = (spec.State.EE_POSE, spec.State.TCP_POSE, spec.State.DELTA_EE_POSE)
    for change in (*fields.sides(1, "poses", _NAME, whole, case.embodiment), *_frames(case.embodiment)):
        yield from fields.mistakes(change, case)


def _numbers(keys: Sequence[str], told: str) -> Iterator[Change]:
    """Yield positions in other units, and those whose axes are exchanged, or point the other way."""
    for unit, factor in UNITS.items():
        if factor != 1.0:
            there, back = (on(keys, fields.placed(partial(np.multiply, one))) for one in (factor, 1 / factor))
            yield Change(1, f"position{told}: in {unit}", _NAME, there, back, back)
            yield Change(1, f"position{told}: in m, not {unit}", _NAME, back, there, there)
    for one, other in itertools.combinations(range(spec.POSITION_DIM), 2):
        order = list(range(spec.POSITION_DIM))
        order[one], order[other] = other, one
        turn = on(keys, fields.placed(partial(np.take, indices=order, axis=-1)))
        yield Change(1, f"position{told}: {'xyz'[one]} and {'xyz'[other]} exchanged", _NAME, turn, turn, turn)
    for axis in range(spec.POSITION_DIM):
        signs = np.where(np.arange(spec.POSITION_DIM) == axis, -1.0, 1.0)
        turn = on(keys, fields.placed(partial(np.multiply, signs)))
        yield Change(2, f"position{told}: {'xyz'[axis]} the other way", _NAME, turn, turn, turn)


def _frames(embodiment: Embodiment) -> Iterator[Change]:
    mounts = _mounts(embodiment)
    if not mounts:
        return
    for later, told, only in fields.PARTS:
        inward, outward = _mounted(mounts, _moved, only, inverse=True), _mounted(mounts, _moved, only, inverse=False)
        into, out = _mounted(mounts, _axes, only, inverse=True), _mounted(mounts, _axes, only, inverse=False)
        change = Change(later, f"frame{told}: base", _NAME, inward, outward, out)
        yield change
        yield change.inverse(f"frame{told}: world, not base", into)
    yield from _stands(mounts)


def _stands(mounts: dict[str, Numbers]) -> Iterator[Change]:
    """Yield bases that stand turned otherwise, or elsewhere: what is left of a frame that was taken off by half."""
    places = {prefix: _placed_at(mount[_PLACE]) for prefix, mount in mounts.items()}
    turns = {prefix: _only_turned(mount[_TURN]) for prefix, mount in mounts.items()}
    for rank, words, count in (
        (1, "turned the other way", -2),
        (1, "not turned", -1),
        (2, "turned", 1),
        (2, "turned twice", 2),
    ):
        about = {prefix: _about(places[prefix], turns[prefix], count) for prefix in mounts}
        yield _stood(rank, f"base: {words}", about)
    for rank, words, share in ((1, "place taken off before the turn", 1), (2, "place taken off after the turn", -1)):
        moved = {
            prefix: _placed_at(share * (rotation.rotate(mount[_TURN], mount[_PLACE]) - mount[_PLACE]))
            for prefix, mount in mounts.items()
        }
        yield _stood(rank, f"base: {words}", moved)
    for words, share in (("place taken off", -1), ("place not taken off", 1)):
        yield _stood(2, f"base: {words}", {prefix: _placed_at(share * mounts[prefix][_PLACE]) for prefix in mounts})


def _stood(rank: int, words: str, transforms: dict[str, Numbers]) -> Change:
    there, back = (_mounted(transforms, _moved, fields.whole, inverse=inverse) for inverse in (False, True))
    return Change(rank, words, _NAME, there, back, None)


def _placed_at(place: Numbers) -> Numbers:
    return np.concatenate((place, rotation.identity()))


def _only_turned(turn: Numbers) -> Numbers:
    return np.concatenate((np.zeros(spec.POSITION_DIM), turn))


def _about(place: Numbers, turn: Numbers, count: int) -> Numbers:
    """Return a turn about a place, applied so many times, backwards if below zero."""
    once = turn if count > 0 else poses.invert(turn)
    outer = place
    for _ in range(abs(count)):
        outer = poses.compose(outer, once)
    return poses.compose(outer, poses.invert(place))


def _mounts(embodiment: Embodiment) -> dict[str, Numbers]:
    """Return the pose of each arm's base in the world; none where the standard does not know them."""
    try:
        return {arm.prefix: mount(embodiment, side) for arm, side in zip(embodiment.arms, embodiment.data["arms"])}
    except ConversionError:
        return {}


def _mounted(
    mounts: dict[str, Numbers],
    moved: Callable[[Numbers, Numbers], Numbers],
    only: Callable[[Function], Function],
    *,
    inverse: bool,
) -> Turn:
    """Return the change of each arm's poses, or of differences of them, from its base to the world, or back."""
    turns = {}
    for prefix, one in mounts.items():
        outer = poses.invert(one) if inverse else one
        turns.update(dict.fromkeys(fields.poses([prefix]), only(partial(moved, outer))))

    def turn(given: Fields) -> dict[str, Numbers]:
        result = dict(given)
        for key in turns.keys() & given.keys():
            result.update(on([key], turns[key])({key: given[key]}))
        return result

    return turn


def _moved(outer: Numbers, pose: Numbers) -> Numbers:
    return poses.compose(outer, pose)


def _axes(outer: Numbers, change: Numbers) -> Numbers:
    turn = outer[_TURN]
    place = rotation.rotate(turn, change[..., _PLACE])
    turned = rotation.multiply(rotation.multiply(turn, change[..., _TURN]), rotation.conjugate(turn))
    return np.concatenate((place, turned), axis=-1)


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    keys={"position": ["frame", "unit"], "rotation": ["frame"]},
    applies=lambda block: bool({"position", "rotation"} & kinds(block)),
)
