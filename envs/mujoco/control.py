"""From an action to position targets: limits are kept, and every time they had to be is counted and reported."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.action import ActionError
from xpl.kinematics import Chain
from xpl.poses import compose, invert, pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.embodiment import Embodiment

# Rounding of float32 actions is no violation.
_ANGLE_SLACK, _OPENING_SLACK = 1e-5, 1e-5
_LEAST_NORM = 1e-3  # below it a quaternion has no direction


@dataclass
class Correction:
    """How one arm's command differed from what was executed, in one control step.

    Attributes:
        excess: largest amount by kind: "joint_limit" (rad past it), "joint_speed" (rad/s past it), "gripper_range"
            (past 0 or 1), "quaternion_norm" (distance of its length from 1), "unreachable" (m, distance of the
            nearest reachable flange position).
        rotation_error: rad, to the target's rotation; only with "unreachable".
    """

    excess: dict[str, float] = field(default_factory=dict)
    rotation_error: float | None = None

    def report(self) -> dict[str, float]:
        """Return the correction as plain numbers; empty if the command was executed as given."""
        extra = {} if self.rotation_error is None else {"rotation_error": self.rotation_error}
        return {**self.excess, **extra}


class ArmControl:
    """Executes the commands of one arm.

    Args:
        data: the embodiment's entry in the spec.
        base: pose (7,) of the arm's base in the world.
        start: joint angles (dof,) at the beginning, gripper open.
        period: length of a control step, s.

    Attributes:
        joints: joint targets (dof,) now in force, rad.
        opening: gripper target now in force, 0 closed, 1 open.
    """

    def __init__(self, data: Any, base: NDArray[np.float64], start: NDArray[np.float64], period: float) -> None:
        self.chain = Chain.from_embodiment(data)
        self.joints = np.array(start, dtype=np.float64)
        self.opening = spec.GRIPPER_OPEN
        self._to_base = invert(base)
        self._largest_change = self.chain.velocity * period
        self._period = period
        effector = data["end_effector"]
        speed, travel = effector["velocity"], effector["finger_range"][1]
        # The fingers move at their own speed; asking for more is how a gripper is used, not a violation.
        self._largest_opening = np.inf if speed is None else speed * period / travel

    def command_joints(self, target: NDArray[np.float64], opening: float) -> Correction:
        """Take joint targets (dof,), rad, and a gripper opening."""
        correction = Correction()
        self._move(target, correction)
        self._grip(opening, correction)
        return correction

    def command_flange(self, target: NDArray[np.float64], opening: float) -> Correction:
        """Take a pose (7,) of the flange in the world and a gripper opening.

        The nearest configuration is executed where the pose is out of reach, and the correction says how far off it is.
        """
        correction = Correction()
        split = spec.POSITION_DIM
        off = abs(_norm(target[split:]) - 1.0)
        if off > spec.QUATERNION_TOLERANCE:
            correction.excess["quaternion_norm"] = off
        unit = pose(target[:split], rotation.normalise(target[split:]))
        solution = self.chain.solve(compose(self._to_base, unit), self.joints)
        if not solution.converged:
            correction.excess["unreachable"] = solution.position_error
            correction.rotation_error = solution.rotation_error
        self._move(solution.joints, correction)
        self._grip(opening, correction)
        return correction

    def _move(self, target: NDArray[np.float64], correction: Correction) -> None:
        allowed = np.clip(target, self.chain.lower, self.chain.upper)
        past = float(np.max(np.abs(target - allowed)))
        if past > _ANGLE_SLACK:
            correction.excess["joint_limit"] = past
        change = allowed - self.joints
        bounded = np.clip(change, -self._largest_change, self._largest_change)
        past = float(np.max(np.abs(change - bounded)))
        if past > _ANGLE_SLACK:
            correction.excess["joint_speed"] = past / self._period
        self.joints = self.joints + bounded

    def _grip(self, opening: float, correction: Correction) -> None:
        allowed = min(spec.GRIPPER_OPEN, max(spec.GRIPPER_CLOSED, opening))
        if abs(opening - allowed) > _OPENING_SLACK:
            correction.excess["gripper_range"] = abs(opening - allowed)
        change = min(self._largest_opening, max(-self._largest_opening, allowed - self.opening))
        self.opening += change


def execute(
    controls: tuple[ArmControl, ...], flat: NDArray[np.float64], embodiment: Embodiment, action_type: str
) -> list[Correction]:
    """Command all arms from one flat, finite action (`xpl.action.pack`); return each arm's correction.

    Raises:
        ActionError: a quaternion has no direction. No arm has been commanded then.
    """
    arm_key, _ = spec.ACTION_KEYS[action_type]
    posed = arm_key == spec.State.EE_POSE
    commands, at = [], 0
    for arm in embodiment.arms:
        dim = embodiment.dims(action_type)[arm.prefix + arm_key]
        target, opening = flat[at : at + dim], float(flat[at + dim])
        at += dim + arm.ee_dim
        if posed and _norm(target[spec.POSITION_DIM :]) < _LEAST_NORM:
            raise ActionError(
                f"{arm.prefix}{arm_key} must hold a unit quaternion, got {target[spec.POSITION_DIM :].tolist()}"
            )
        commands.append((target, opening))
    return [
        control.command_flange(target, opening) if posed else control.command_joints(target, opening)
        for control, (target, opening) in zip(controls, commands, strict=True)
    ]


def _norm(vector: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.sum(vector * vector)))
