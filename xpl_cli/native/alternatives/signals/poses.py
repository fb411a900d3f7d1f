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
from xpl.convert import NativeError, frames, rotations
from xpl_cli.native.alternatives.signals.fields import Change, Fields, Function, Numbers, Turn, on, scopes

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

_PLACE, _TURN = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)
_KEYS = (spec.State.EE_POSE, spec.State.TCP_POSE)
_FORMS = ("xyz", "XYZ", "zyx", "ZYX", "axis_angle")


def poses(embodiment: Embodiment) -> Iterator[Change]:
    """Yield ways to write poses."""
    for later, told, prefixes in scopes(embodiment.prefixes):
        keys = [prefix + key for prefix in prefixes for key in _KEYS]
        for change in (*_rotations(keys, told), *_units(keys, told)):
            yield replace(change, rank=change.rank + later)
    yield from _points(embodiment)
    yield from _frames(embodiment)


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


def _points(embodiment: Embodiment) -> Iterator[Change]:
    try:
        tool = frames.tool(embodiment)
    except NativeError:
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
    sides = list(embodiment.data["arms"])
    try:
        mounts = {arm.prefix: frames.mount(embodiment, side) for arm, side in zip(embodiment.arms, sides, strict=True)}
    except NativeError:
        return
    for later, told, only in _PARTS:
        inward, outward = _mounted(mounts, _moved, only, inverse=True), _mounted(mounts, _moved, only, inverse=False)
        into, out = _mounted(mounts, _axes, only, inverse=True), _mounted(mounts, _axes, only, inverse=False)
        change = Change(later, f"frame{told}: base", "frame", inward, outward, out)
        yield change
        yield change.inverse(f"frame{told}: world, not base", into)


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

    def turn(fields: Fields) -> dict[str, object]:
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
