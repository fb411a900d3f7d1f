"""How the standard's commands become those of one of ManiSkill's controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from xpl import _spec as spec
from xpl import get_embodiment, rotation
from xpl.kinematics import Chain
from xpl.poses import compose, invert
from xpl.simulator.pose_deltas import COMMANDED, PoseDeltas, clip

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from .arm import Arm

ACTION_RANGE, UNREACHED = "action_range", "unreached"
_SLACK = 1e-4  # of the range of an action: rounding of float32 commands is no violation
_DELTA = "delta"
_BY_ANGLES = ("so100",)  # robots for which ManiSkill has no controller of poses
_NEAR = 1e-3  # m: a pose that is met by this much is met

ControllerCommand = tuple["NDArray[np.float64]", dict[str, float]]
"""The command of the arm's controller (its gripper comes after it), and the corrections."""


class Control(Protocol):
    """One of ManiSkill's control modes for one arm."""

    mode: str
    """ManiSkill's name of it."""

    def begin(self, arm: Arm) -> None:
        """Begin an episode."""

    def controller_command(self, action: Mapping[str, Any], arm: Arm) -> ControllerCommand:
        """Return the controller's command for an action of this arm."""


class Joints:
    """Angles, rad; the gripper's command is its own."""

    mode = "pd_joint_pos"

    def begin(self, arm: Arm) -> None:
        """Nothing is carried over."""

    def controller_command(self, action: Mapping[str, Any], arm: Arm) -> ControllerCommand:
        """Return angles as they are."""
        angles = action[spec.State.ARM_JOINT_STATE].astype(np.float64)
        return np.append(angles, arm.gripper.command(float(action[spec.State.EE_JOINT_STATE][0]))), {}


class JointChanges:
    """Changes of angles: 1 is the most that the controller moves in a step, from where the joints are."""

    mode = "pd_joint_delta_pos"

    def begin(self, arm: Arm) -> None:
        """Count from the angles that a policy observes first."""
        self._range = arm.largest_change
        self._before = arm.state[spec.State.ARM_JOINT_STATE].astype(np.float32).astype(np.float64)

    def controller_command(self, action: Mapping[str, Any], arm: Arm) -> ControllerCommand:
        """Return how far the command went on from the one before."""
        target = action[spec.State.ARM_JOINT_STATE].astype(np.float64)
        change, past = clip(((target - self._before) / self._range[: len(target)]).tolist(), together=False)
        self._before = target
        opening = float(action[spec.State.EE_JOINT_STATE][0])
        return np.append(change, arm.gripper.change(opening, self._range)), _beyond(past)


class Poses:
    """Poses of the point between the fingers in the arm's base; ManiSkill finds the angles."""

    mode = "pd_ee_pose"

    def begin(self, arm: Arm) -> None:
        """Nothing is carried over."""

    def controller_command(self, action: Mapping[str, Any], arm: Arm) -> ControllerCommand:
        """Return position, and angles about x, then the new y, then the new z."""
        pose = arm.reached(action[spec.State.EE_POSE].astype(np.float64))
        command = np.append(pose[: spec.POSITION_DIM], euler(pose[spec.POSITION_DIM :]))
        return np.append(command, arm.gripper.command(float(action[spec.State.EE_JOINT_STATE][0]))), {}


class PoseChanges:
    """Changes of the pose of the point between the fingers along and about the axes of the arm's base.

    An action of 1 moves by 0.1 m and turns by 0.1 rad, against the sense of the axis: ManiSkill multiplies turns by the
    lower end of their range. It counts changes from where the point is.
    """

    mode = "pd_ee_delta_pose"

    def __init__(self) -> None:
        self._changes = PoseDeltas(COMMANDED)

    def begin(self, arm: Arm) -> None:
        """Count from the pose that a policy observes first."""
        config = arm.agent.controller.controllers["arm"].config
        self._move, self._turn = config.pos_upper, config.rot_lower
        self._changes.begin(arm.reached(arm.state[spec.State.EE_POSE].astype(np.float32)))

    def controller_command(self, action: Mapping[str, Any], arm: Arm) -> ControllerCommand:
        """Return how far the command went on from the one before."""
        present = arm.reached(arm.state[spec.State.EE_POSE])
        change = self._changes.delta(arm.reached(action[spec.State.EE_POSE]), present)
        move, past = clip((change[:3] / self._move).tolist(), together=False)
        turn, turned_past = bounded_turn(euler(rotation.from_axis_angle(change[3:])) / self._turn)
        command = np.concatenate([move, turn])
        opening = arm.gripper.command(float(action[spec.State.EE_JOINT_STATE][0]))
        return np.append(command, opening), _beyond(max(past, turned_past))


class SolvedPoses:
    """Poses for an arm that ManiSkill commands by joint angles alone: inverse kinematics, as near as possible."""

    mode = "pd_joint_pos"

    def __init__(self, robot: str) -> None:
        self._chain = Chain.from_embodiment(get_embodiment(robot).data)

    def begin(self, arm: Arm) -> None:
        """Search from where the joints are."""
        self._angles = arm.state[spec.State.ARM_JOINT_STATE]

    def controller_command(self, action: Mapping[str, Any], arm: Arm) -> ControllerCommand:
        """Return angles."""
        flange = compose(invert(arm.base), action[spec.State.EE_POSE].astype(np.float64))
        solution = self._chain.solve(flange, self._angles)
        self._angles = solution.joints
        command = np.append(solution.joints, arm.gripper.command(float(action[spec.State.EE_JOINT_STATE][0])))
        missed = float(solution.position_error)
        return command, ({UNREACHED: missed} if missed > _NEAR else {})


def control_of(action_type: str, words: Sequence[str], robot: str) -> Control:
    """Return the control of an arm.

    Args:
        action_type: of the standard.
        words: of the setting.
        robot: the standard's name of it.

    Raises:
        ValueError: ManiSkill has no such controller.
    """
    is_delta = _DELTA in words
    if action_type == spec.ACTION_TYPES[0]:
        return JointChanges() if is_delta else Joints()
    if robot not in _BY_ANGLES:
        return PoseChanges() if is_delta else Poses()
    if is_delta:
        raise ValueError(f"ManiSkill commands {robot} by angles alone: changes of a pose are not offered")
    return SolvedPoses(robot)


def euler(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles (3,), rad, about x, then the new y, then the new z, as ManiSkill counts them."""
    m = rotation.to_matrix(quaternion)
    return np.array(
        [np.arctan2(-m[1, 2], m[2, 2]), np.arcsin(np.clip(m[0, 2], -1.0, 1.0)), np.arctan2(-m[0, 1], m[0, 0])]
    )


def bounded_turn(turn: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return a turn no longer than 1, as ManiSkill bounds it, and how much longer it was."""
    length = float(np.linalg.norm(turn))
    return (turn / length, length - 1.0) if length > 1.0 else (turn, 0.0)


def _beyond(past: float) -> dict[str, float]:
    return {ACTION_RANGE: past} if past > _SLACK else {}
