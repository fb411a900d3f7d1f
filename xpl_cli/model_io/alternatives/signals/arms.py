"""Joints and grippers as models write them: units, orders, signs, ranges, and whose they are."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl_cli.model_io.alternatives.signals.fields import Change, Function, exchanged, on, scopes

if TYPE_CHECKING:
    from xpl.convert.parts import Numbers
    from xpl.embodiment import Embodiment

_ZEROS = (90, -90, 180, -180)
"""Where joints of models have their zero, from the standard's, deg."""
_JOINTS, _EFFECTOR = spec.State.ARM_JOINT_STATE, spec.State.EE_JOINT_STATE


def _linear(  # noqa: PLR0913, PLR0917 - one line of numbers
    rank: int, words: str, convention: str, keys: list[str], scale: float, offset: float
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


def joints(embodiment: Embodiment) -> Iterator[Change]:
    """Yield units, orders and signs of joint angles."""
    arm = embodiment.arms[0]
    for later, told, prefixes in scopes(embodiment.prefixes):
        keys = [prefix + _JOINTS for prefix in prefixes]
        yield _linear(later, f"unit{told}: deg", "angle_unit", keys, float(np.rad2deg(1.0)), 0.0)
        yield _linear(later, f"unit{told}: rad, not deg", "angle_unit", keys, float(np.deg2rad(1.0)), 0.0)
        for rank, name, order in _orders(arm.dof):
            back = np.argsort(order)
            yield _permuted(rank + later, f"joint order{told}: {name}", keys, order, [int(one) for one in back])
        for index in range(arm.dof):
            signs = np.where(np.arange(arm.dof) == index, -1.0, 1.0)
            yield _signed(1 + later, f"sign of joint {index + 1}{told}: the other", keys, signs)
        yield _signed(2 + later, f"signs of all joints{told}: the other", keys, -np.ones(arm.dof))
        for index, degrees in itertools.product(range(arm.dof), _ZEROS):
            yield _zeroed(2 + later, f"zero of joint {index + 1}{told}: {degrees:+} deg", keys, index, degrees)
    keys = [prefix + _JOINTS for prefix in embodiment.prefixes]
    for rank, count in ((2, 2), (3, 3)):
        for several in itertools.combinations(range(arm.dof), count):
            signs = np.where(np.isin(np.arange(arm.dof), several), -1.0, 1.0)
            told = ", ".join(str(one + 1) for one in several)
            yield _signed(rank, f"signs of joints {told}: the other", keys, signs)
    if arm.gripper != "parallel_gripper":
        hands = [prefix + _EFFECTOR for prefix in embodiment.prefixes]
        yield _linear(0, "unit of hands: deg", "angle_unit", hands, float(np.rad2deg(1.0)), 0.0)
        yield _linear(0, "unit of hands: rad, not deg", "angle_unit", hands, float(np.deg2rad(1.0)), 0.0)


def _orders(count: int) -> list[tuple[int, str, list[int]]]:
    straight = list(range(count))
    found = [(0, "reversed", straight[::-1])]
    found += [(1, "the last one first", [straight[-1], *straight[:-1]])]
    found += [(1, "the first one last", [*straight[1:], straight[0]])]
    pairs = sorted(itertools.combinations(straight, 2), key=lambda pair: pair[1] - pair[0])
    for one, other in pairs:
        order = list(straight)
        order[one], order[other] = other, one
        found.append((1 if other == one + 1 else 2, f"{one + 1} and {other + 1} exchanged", order))
    return found


def _permuted(rank: int, words: str, keys: list[str], order: list[int], back: list[int]) -> Change:
    undo = on(keys, _taken(back))
    return Change(rank, words, "joint_order", on(keys, _taken(order)), undo, undo)


def _taken(order: list[int]) -> Function:
    def take(values: Numbers) -> Numbers:
        result: Numbers = values[..., order]
        return result

    return take


def _signed(rank: int, words: str, keys: list[str], signs: Numbers) -> Change:
    turn = on(keys, lambda values: values * signs)
    return Change(rank, words, "joint_order", turn, turn, turn)


def _zeroed(rank: int, words: str, keys: list[str], index: int, degrees: int) -> Change:
    def moved(values: Numbers, *, by: float) -> Numbers:
        result = np.array(values)
        result[..., index] += by
        return result

    there, back = (on(keys, partial(moved, by=sign * np.deg2rad(degrees))) for sign in (1.0, -1.0))
    return Change(rank, words, "joint_order", there, back, None)


def grippers(embodiment: Embodiment) -> Iterator[Change]:
    """Yield directions, ranges and units of parallel grippers.

    A command that is quite closed or quite open may have been clipped: what it would be otherwise is not known.
    """
    if embodiment.arms[0].gripper != "parallel_gripper":
        return
    for later, told, prefixes in scopes(embodiment.prefixes):
        keys = [prefix + _EFFECTOR for prefix in prefixes]
        for rank, name, closed, opened in _ranges(embodiment.arms[0].stroke):
            words = f"gripper{told}: {name}"
            change = _linear(rank + later, words, "gripper", keys, opened - closed, closed)
            yield replace(change, back=on(keys, partial(_unclipped, scale=opened - closed, offset=closed)))


def _unclipped(values: Numbers, *, scale: float, offset: float) -> Numbers:
    back = np.clip((values - offset) / scale, spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN)
    if (scale, offset) == (-1.0, 1.0):  # what is clipped there is clipped here
        return back
    inside = (values > spec.GRIPPER_CLOSED) & (values < spec.GRIPPER_OPEN)
    return np.where(inside, back, np.nan)


def _ranges(stroke: float | None) -> list[tuple[int, str, float, float]]:
    """Return rank, words, and what closed and open are for the model where the adapter says 0 and 1."""
    found = [
        (0, "closed and open exchanged", 1.0, 0.0),
        (0, "open is half as much", 0.0, 0.5),
        (0, "open is twice as much", 0.0, 2.0),
        (1, "closed -1, open 1", -1.0, 1.0),
        (1, "closed 1, open -1", 1.0, -1.0),
        (1, "closed 0, open 1, not -1 and 1", 0.5, 1.0),
        (1, "closed 1, open 0, not -1 and 1", 0.5, 0.0),
        (2, "closed 0, open 100", 0.0, 100.0),
        (2, "closed 0, open 1, not 100", 0.0, 0.01),
        (2, "closed 0, open 255", 0.0, 255.0),
        (2, "closed 0, open 1, not 255", 0.0, 1 / 255.0),
    ]
    for most in (100.0, 255.0):
        found += [(2, f"closed {most:g}, open 0, not 1 and 0", 1.0 - most, 1.0)]
        found += [(2, f"closed 1, open 0, not {most:g} and 0", 1.0 - 1 / most, 1.0)]
    for rank, metres, name in ((0, stroke, "metres between the fingers"), (1, (stroke or 0) / 2, "metres of a finger")):
        if metres:
            found += [(rank, name, 0.0, metres), (rank, f"0 to 1, not {name}", 0.0, 1 / metres)]
            found += [(2, f"milli{name}", 0.0, 1000 * metres), (2, f"0 to 1, not milli{name}", 0.0, 1 / metres / 1000)]
            found += [(3, f"{name}, closed and open exchanged", metres, 0.0)]
    return found


def sides(embodiment: Embodiment) -> Iterator[Change]:
    """Yield the exchange of left and right: of all fields, or of one kind."""
    if len(embodiment.arms) != 2:
        return
    one, other = embodiment.prefixes
    poses = (spec.State.EE_POSE, spec.State.TCP_POSE, spec.State.DELTA_EE_POSE)
    for rank, words, convention, names in (
        (0, "arms: left and right exchanged", "joint_order", (_JOINTS, _EFFECTOR, *poses)),
        (0, "grippers: left and right exchanged", "gripper", (_EFFECTOR,)),
        (1, "joints: left and right exchanged", "joint_order", (_JOINTS,)),
        (1, "poses: left and right exchanged", "frame", poses),
        (2, "joints and poses: left and right exchanged", "joint_order", (_JOINTS, *poses)),
    ):
        turn = exchanged({one + name: other + name for name in names})
        yield Change(rank, words, convention, turn, turn, turn)
