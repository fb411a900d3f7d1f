"""Limits that commands are checked against: motion in one control step, and joint limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk
from xpl import rotation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from xpl.contract import Action, State
    from xpl.embodiment import Embodiment

_ROUNDING = 1e-3
"""Share by which a limit may be passed: float32 and the rounding of regressed values."""


@dataclass(frozen=True)
class Excess:
    """A command beyond a limit.

    Attributes:
        what: where, as in `left_arm_joint_state[2]`, or `position of left_ee_pose`.
        value: how much there is of it.
        limit: how much is possible.
        unit: of both.
    """

    what: str
    value: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return f"{self.what}: {self.value:.3g} {self.unit}, possible are {self.limit:.3g}"


def jumps(embodiment: Embodiment, before: State, after: Action, frequency: float) -> Iterator[Excess]:
    """Yield what changes more between two states or actions than the robot can move in one control step.

    Grippers may jump: their commands are targets, not paths.

    Args:
        embodiment: the robot.
        before: arm values by key.
        after: an action step; its keys decide what is compared.
        frequency: control rate, Hz.
    """
    for arm in embodiment.arms:
        joints, pose = arm.prefix + sdk.State.ARM_JOINT_STATE, arm.prefix + sdk.State.EE_POSE
        if joints in after:
            speed = np.full(arm.dof, sdk.JOINT_SPEED) if arm.velocity is None else arm.velocity
            change = np.abs(_values(after[joints]) - _values(before[joints]))
            limit = speed / frequency * (1 + _ROUNDING) + sdk.JOINT_TOLERANCE
            worst = int(np.argmax(change / limit))
            if change[worst] > limit[worst]:
                yield Excess(f"{joints}[{worst}]", float(change[worst]), float(limit[worst]), "rad")
        if pose in after:
            yield from _pose_jumps(pose, _values(before[pose]), _values(after[pose]), frequency)


def outside(embodiment: Embodiment, action: Action, allowed: float = 0.0) -> Iterator[Excess]:
    """Yield the joints of an action step that are commanded past their limits, where these are known.

    Args:
        embodiment: the robot.
        action: the step.
        allowed: how far past a limit a command may lie, rad.
    """
    for arm in embodiment.arms:
        key = arm.prefix + sdk.State.ARM_JOINT_STATE
        if key not in action or arm.lower is None or arm.upper is None:
            continue
        values = _values(action[key])
        for index in np.flatnonzero(values > arm.upper + allowed + sdk.JOINT_TOLERANCE):
            yield Excess(f"{key}[{index}]", float(values[index]), float(arm.upper[index]), "rad")
        for index in np.flatnonzero(values < arm.lower - allowed - sdk.JOINT_TOLERANCE):
            yield Excess(f"{key}[{index}]", float(values[index]), float(arm.lower[index]), "rad")


def farthest(embodiment: Embodiment, state: State, chunk: Sequence[Action]) -> float:
    """Return how far any joint is commanded from where it is observed, rad."""
    keys = [arm.prefix + sdk.State.ARM_JOINT_STATE for arm in embodiment.arms]
    moved = [np.abs(_values(step[key]) - _values(state[key])).max() for step in chunk for key in keys if key in step]
    return float(max(moved, default=0.0))


def _pose_jumps(key: str, before: np.ndarray, after: np.ndarray, frequency: float) -> Iterator[Excess]:
    shift = float(np.linalg.norm(after[: sdk.POSITION_DIM] - before[: sdk.POSITION_DIM]))
    turn = float(rotation.angle_between(_orientation(before), _orientation(after)))
    for what, value, speed, unit in (
        (f"position of {key}", shift, sdk.POSITION_SPEED, "m"),
        (f"orientation of {key}", turn, sdk.ROTATION_SPEED, "rad"),
    ):
        limit = speed / frequency * (1 + _ROUNDING) + sdk.POSITION_TOLERANCE
        if value > limit:
            yield Excess(what, value, limit, unit)


def _orientation(pose: np.ndarray) -> np.ndarray:
    return rotation.normalise(pose[sdk.POSITION_DIM :])


def _values(values: ArrayLike) -> np.ndarray:
    return np.asarray(values, dtype=np.float64)
