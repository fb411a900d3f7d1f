"""Poses as models write them: order and sense of rotations, point, frame, unit."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import poses as pose_math
from xpl import rotation
from xpl.convert import ConversionError, frames, rotations
from xpl_cli.model_io.alternatives.signals.fields import Change, Fields, Function, Turn, on, scopes

if TYPE_CHECKING:
    from xpl.convert.parts import Numbers
    from xpl.embodiment import Embodiment

_PLACE, _TURN = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)
_KEYS = (spec.State.EE_POSE, spec.State.TCP_POSE)
_FORMS = ("xyz", "XYZ", "zyx", "ZYX", "axis_angle")


def poses(embodiment: Embodiment) -> Iterator[Change]:
    """Yield ways to write poses."""
    for later, told, prefixes in scopes(embodiment.prefixes):
        keys = [prefix + key for prefix in prefixes for key in _KEYS]
        for change in (*_rotations(keys, told), *_angles(keys, told), *_units(keys, told), *_axes_of(keys, told)):
            yield replace(change, rank=change.rank + later)
    yield from _points(embodiment)
    yield from _hands(embodiment)
    yield from _frames(embodiment)
    yield from _stands(embodiment)


def _turned(function: Function) -> Function:
    """Return the change of poses that changes their quaternions."""
    return lambda pose: np.concatenate((pose[..., _PLACE], function(pose[..., _TURN])), axis=-1)


def _placed(function: Function) -> Function:
    return lambda pose: np.concatenate((function(pose[..., _PLACE]), pose[..., _TURN]), axis=-1)


def _rotations(keys: Sequence[str], told: str) -> Iterator[Change]:
    there, back = on(keys, _turned(partial(_rolled, by=-1))), on(keys, _turned(partial(_rolled, by=1)))
    order = Change(0, f"quaternion{told}: xyzw", "rotation", there, back, back)
    yield order
    yield order.inverse(f"quaternion{told}: wxyz, not xyzw", there)
    inverse = on(keys, _turned(rotation.conjugate))
    yield Change(0, f"rotation{told}: transposed (rows for columns)", "rotation", inverse, inverse, inverse)
    for words, sign in (("w >= 0", 1.0), ("w <= 0", -1.0)):
        signed = on(keys, _turned(partial(_signed, sign=sign)))
        yield Change(1, f"quaternion{told}: {words}", "rotation", signed, signed, None, ways=("state",))
    negative = on(keys, _turned(np.negative))
    yield Change(1, f"quaternion{told}: the other sign", "rotation", negative, negative, None, ways=("state",))
    for one, other in itertools.permutations(_FORMS, 2):
        there, back = (
            on(keys, _turned(partial(_reread, of=one, by=other))),
            on(keys, _turned(partial(_reread, of=other, by=one))),
        )
        yield Change(2, f"rotation{told}: {_form(one)}, not {_form(other)}", "rotation", there, back, back)


def _angles(keys: Sequence[str], told: str) -> Iterator[Change]:
    """Yield other angles of the turns that a model answers."""
    for words, factor in (("twice", 2.0), ("half", 0.5)):
        there, back = (on(keys, _turned(partial(_powered, by=one))) for one in (1 / factor, factor))
        yield Change(1, f"turn{told}: {words} the angle", "rotation", there, back, back, ways=("action",))


def _powered(quaternion: Numbers, *, by: float) -> Numbers:
    return rotation.from_axis_angle(by * rotation.to_axis_angle(quaternion))


def _rolled(quaternion: Numbers, *, by: int) -> Numbers:
    return np.roll(quaternion, by, axis=-1)


def _signed(quaternion: Numbers, *, sign: float) -> Numbers:
    return np.where(quaternion[..., :1] * sign < 0, -quaternion, quaternion)


def _reread(quaternion: Numbers, *, of: str, by: str) -> Numbers:
    """Return the rotation that one form's numbers mean in another."""
    return _read(_written(quaternion, of), by)


def _written(quaternion: Numbers, form: str) -> Numbers:
    return rotations.encode(quaternion, *((form,) if form == "axis_angle" else ("euler", form)))


def _read(numbers: Numbers, form: str) -> Numbers:
    return rotations.decode(numbers, *((form,) if form == "axis_angle" else ("euler", form)))


def _form(name: str) -> str:
    return name if name == "axis_angle" else f"euler {name}"


def _units(keys: Sequence[str], told: str) -> Iterator[Change]:
    for unit, factor in (("cm", 100.0), ("mm", 1000.0)):
        there, back = (
            on(keys, _placed(partial(np.multiply, factor))),
            on(keys, _placed(partial(np.multiply, 1 / factor))),
        )
        yield Change(1, f"position{told}: in {unit}", "frame", there, back, back)
        yield Change(1, f"position{told}: in m, not {unit}", "frame", back, there, there)


def _axes_of(keys: Sequence[str], told: str) -> Iterator[Change]:
    """Yield positions whose axes are exchanged, or point the other way."""
    for one, other in itertools.combinations(range(spec.POSITION_DIM), 2):
        order = list(range(spec.POSITION_DIM))
        order[one], order[other] = other, one
        turn = on(keys, _placed(partial(np.take, indices=order, axis=-1)))
        yield Change(1, f"position{told}: {'xyz'[one]} and {'xyz'[other]} exchanged", "frame", turn, turn, turn)
    for axis in range(spec.POSITION_DIM):
        signs = np.where(np.arange(spec.POSITION_DIM) == axis, -1.0, 1.0)
        turn = on(keys, _placed(partial(np.multiply, signs)))
        yield Change(2, f"position{told}: {'xyz'[axis]} the other way", "frame", turn, turn, turn)


def _points(embodiment: Embodiment) -> Iterator[Change]:
    try:
        tool = frames.tool(embodiment)
    except ConversionError:
        return
    keys = [prefix + key for prefix in embodiment.prefixes for key in _KEYS]
    away = pose_math.invert(tool)
    for later, told, only in _PARTS:
        there = on(keys, only(lambda pose: pose_math.compose(pose, tool)))
        back = on(keys, only(lambda pose: pose_math.compose(pose, away)))
        if told == " of the position":  # which moves by what the rotation says, and that stays
            back = on(keys, only(lambda pose: pose_math.compose(pose, _unturned(tool))))
        change = Change(later, f"point{told}: tcp", "point", there, back, None)
        yield change
        yield change.inverse(f"point{told}: flange, not tcp")


def _hands(embodiment: Embodiment) -> Iterator[Change]:
    """Yield hands that are turned about an axis of their own."""
    keys = [prefix + key for prefix in embodiment.prefixes for key in _KEYS]
    for rank, axis, degrees in (
        *((2, 2, degrees) for degrees in (45, -45, 90, -90, 180, 135, -135)),
        *((3, axis, degrees) for axis in (0, 1) for degrees in (90, -90, 180)),
    ):
        turn = rotation.from_axis_angle(np.deg2rad(degrees) * np.eye(3)[axis])
        there, back = (on(keys, _turned(partial(_turned_by, by=one))) for one in (turn, rotation.conjugate(turn)))
        told = f"hand: turned by {degrees:+} deg about its {'xyz'[axis]}"
        yield Change(rank, told, "point", there, back, None)


def _turned_by(quaternion: Numbers, *, by: Numbers) -> Numbers:
    return rotation.multiply(quaternion, by)


def _unturned(tool: Numbers) -> Numbers:
    return np.concatenate((-tool[_PLACE], rotation.identity()))


def _whole(function: Function) -> Function:
    return function


def _position(function: Function) -> Function:
    return lambda pose: np.concatenate((function(pose)[..., _PLACE], pose[..., _TURN]), axis=-1)


def _rotation(function: Function) -> Function:
    return lambda pose: np.concatenate((pose[..., _PLACE], function(pose)[..., _TURN]), axis=-1)


_PARTS: tuple[tuple[int, str, Callable[[Function], Function]], ...] = (
    (0, "", _whole),
    (1, " of the position", _position),
    (1, " of the rotation", _rotation),
)
"""What of a pose is changed: how much later it is tried, how it is called."""


def _frames(embodiment: Embodiment) -> Iterator[Change]:
    mounts = _mounts(embodiment)
    if not mounts:
        return
    for later, told, only in _PARTS:
        inward, outward = _mounted(mounts, _moved, only, inverse=True), _mounted(mounts, _moved, only, inverse=False)
        into, out = _mounted(mounts, _axes, only, inverse=True), _mounted(mounts, _axes, only, inverse=False)
        change = Change(later, f"frame{told}: base", "frame", inward, outward, out)
        yield change
        yield change.inverse(f"frame{told}: world, not base", into)


def _stands(embodiment: Embodiment) -> Iterator[Change]:
    """Yield bases that stand turned otherwise, or elsewhere: what is left of a frame that was taken off by half."""
    mounts = _mounts(embodiment)
    if not mounts:
        return
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
    there, back = (_mounted(transforms, _moved, _whole, inverse=inverse) for inverse in (False, True))
    return Change(rank, words, "frame", there, back, None)


def _placed_at(place: Numbers) -> Numbers:
    return np.concatenate((place, rotation.identity()))


def _only_turned(turn: Numbers) -> Numbers:
    return np.concatenate((np.zeros(spec.POSITION_DIM), turn))


def _about(place: Numbers, turn: Numbers, count: int) -> Numbers:
    """Return a turn about a place, applied so many times, backwards if below zero."""
    outer = pose_math.compose(place, turn if count > 0 else pose_math.invert(turn))
    for _ in range(abs(count) - 1):
        outer = pose_math.compose(outer, turn if count > 0 else pose_math.invert(turn))
    return pose_math.compose(outer, pose_math.invert(place))


def _mounts(embodiment: Embodiment) -> dict[str, Numbers]:
    """Return the pose of each arm's base in the world; none where the standard does not know them."""
    sides = list(embodiment.data["arms"])
    try:
        return {arm.prefix: frames.mount(embodiment, side) for arm, side in zip(embodiment.arms, sides, strict=True)}
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
    for prefix, mount in mounts.items():
        outer = pose_math.invert(mount) if inverse else mount
        for key in _KEYS:
            turns[prefix + key] = only(partial(moved, outer))

    def turn(fields: Fields) -> dict[str, Numbers]:
        result = dict(fields)
        for key in turns.keys() & fields.keys():
            result.update(on([key], turns[key])({key: fields[key]}))
        return result

    return turn


def _moved(outer: Numbers, pose: Numbers) -> Numbers:
    return pose_math.compose(outer, pose)


def _axes(outer: Numbers, change: Numbers) -> Numbers:
    turn = outer[_TURN]
    place = rotation.rotate(turn, change[..., _PLACE])
    turned = rotation.multiply(rotation.multiply(turn, change[..., _TURN]), rotation.conjugate(turn))
    return np.concatenate((place, turned), axis=-1)
