"""Poses and angles in other conventions than the standard's, as a policy with a wrong convention commands them.

A policy moves a robot from its current pose, so the first action of a chunk is near the observed pose. If it is far
from that, and repeatedly near the same pose in another convention, the policy uses that convention.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk
from xpl import rotation
from xpl.action import unpack
from xpl.kinematics import Chain, KinematicsError
from xpl.poses import compose, invert

if TYPE_CHECKING:
    from xpl.contract import State
    from xpl.embodiment import Arm, Embodiment
    from xpl_cli.audit.physics.rollout import PhysicsInference

_LEAST_QUERIES = 3
_JOINTS_APART, _POSES_APART = 0.1, 0.03  # rad, m: nearer to the observed state, there is no mismatch
_METRES_PER_RADIAN = 0.1  # how much of a position one radian of a rotation counts
_NEARER = 5.0  # times, at every inference


@dataclass(frozen=True)
class ConventionMismatch:
    """A convention of actions that differs from that of observations.

    Attributes:
        key: key of the action.
        what: what the action contains instead.
        advice: what to do.
        observed: observed values at the first inference.
        commanded: commanded values at the first inference.
    """

    key: str
    what: str
    advice: str
    observed: tuple[float, ...]
    commanded: tuple[float, ...]


@dataclass(frozen=True)
class _Convention:
    """Another convention for the pose of an arm.

    Attributes:
        what, advice: as in `ConventionMismatch`.
        expressed: returns the observed pose in this convention, or None if it is unknown.
    """

    what: str
    advice: str
    expressed: Callable[[State, Embodiment, Arm], np.ndarray | None]


def mismatches(
    robot: Embodiment, action_type: str, queries: Sequence[PhysicsInference]
) -> Iterator[ConventionMismatch]:
    """Yield the wrong convention of every arm in a rollout, if one explains all its actions.

    Args:
        robot: the embodiment.
        action_type: joint or end-effector control.
        queries: the inferences of one environment, with the observed states.
    """
    if len(queries) < _LEAST_QUERIES:
        return
    kind = sdk.ACTION_KEYS[action_type][0]
    distance_between, tolerance, conventions = (
        (_pose_distance, _POSES_APART, _POSE_CONVENTIONS)
        if kind == sdk.State.EE_POSE
        else (_joint_distance, _JOINTS_APART, _JOINT_CONVENTIONS)
    )
    for arm in robot.arms:
        key = arm.prefix + kind
        commands = [np.asarray(unpack(query.chunk[0], robot, action_type)[key], dtype=np.float64) for query in queries]
        states = [query.state for query in queries]
        distances = [
            distance_between(command, _as_float(state[key])) for command, state in zip(commands, states, strict=True)
        ]
        if min(distances) < tolerance:
            continue
        for convention in conventions:
            values = [convention.expressed(state, robot, arm) for state in states]
            if all(
                value is not None and _NEARER * distance_between(command, value) < distance
                for command, value, distance in zip(commands, values, distances, strict=True)
            ):
                observed = tuple(np.round(_as_float(states[0][key]), 3).tolist())
                commanded = tuple(np.round(commands[0], 3).tolist())
                yield ConventionMismatch(key, convention.what, convention.advice, observed, commanded)
                break


def _pose_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Return the distance between two poses, m."""
    shift = float(np.linalg.norm(first[: sdk.POSITION_DIM] - second[: sdk.POSITION_DIM]))
    turns = [rotation.normalise(pose[sdk.POSITION_DIM :]) for pose in (first, second)]
    return shift + _METRES_PER_RADIAN * float(rotation.angle_between(*turns))


def _joint_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Return the largest difference between two joint configurations, rad."""
    return float(np.abs(first - second).max())


def _as_float(value: object) -> np.ndarray:
    return np.asarray(value, dtype=np.float64)


def _flange(state: State, arm: Arm) -> np.ndarray:
    return _as_float(state[arm.prefix + sdk.State.EE_POSE])


def _tcp_pose(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    return _as_float(state[arm.prefix + sdk.State.TCP_POSE])


def _flange_in_base_frame(state: State, robot: Embodiment, arm: Arm) -> np.ndarray | None:
    try:
        chain = Chain.from_embodiment(robot.data)
    except KinematicsError:
        return None
    return chain.flange(_as_float(state[arm.prefix + sdk.State.ARM_JOINT_STATE]))


def _tcp_in_base_frame(state: State, robot: Embodiment, arm: Arm) -> np.ndarray | None:
    base = _flange_in_base_frame(state, robot, arm)
    tool = compose(invert(_flange(state, arm)), _as_float(state[arm.prefix + sdk.State.TCP_POSE]))
    return None if base is None else compose(base, tool)


def _quaternion_xyzw(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    pose = _flange(state, arm)
    return np.concatenate([pose[: sdk.POSITION_DIM], np.roll(pose[sdk.POSITION_DIM :], -1)])


def _in_millimetres(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    pose = _flange(state, arm)
    return np.concatenate([1000 * pose[: sdk.POSITION_DIM], pose[sdk.POSITION_DIM :]])


def _in_degrees(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    angles: np.ndarray = np.degrees(_as_float(state[arm.prefix + sdk.State.ARM_JOINT_STATE]))
    return angles


def _other_arm(kind: str) -> Callable[[State, Embodiment, Arm], np.ndarray | None]:
    def expressed(state: State, robot: Embodiment, arm: Arm) -> np.ndarray | None:
        others = [other for other in robot.arms if other is not arm]
        return _as_float(state[others[0].prefix + kind]) if others else None

    return expressed


_OTHER_ARM = "the pose of the other arm"
_OTHER_ARM_ADVICE = "check left and right: an action is packed left arm, left gripper, right arm, right gripper"
_POSE_CONVENTIONS = (
    _Convention(
        "the TCP between the fingertips",
        "command the flange: xpl.kinematics converts TCP poses",
        _tcp_pose,
    ),
    _Convention("the flange in the frame of the arm's base", "command poses in the world frame", _flange_in_base_frame),
    _Convention(
        "the TCP in the frame of the arm's base",
        "command the flange in the world frame",
        _tcp_in_base_frame,
    ),
    _Convention("the quaternion as [x, y, z, w]", "poses are [x, y, z, qw, qx, qy, qz]", _quaternion_xyzw),
    _Convention("positions in millimetres", "positions are in metres", _in_millimetres),
    _Convention(_OTHER_ARM, _OTHER_ARM_ADVICE, _other_arm(sdk.State.EE_POSE)),
)
_JOINT_CONVENTIONS = (
    _Convention("joint angles in degrees", "joint angles are in radians", _in_degrees),
    _Convention(_OTHER_ARM, _OTHER_ARM_ADVICE, _other_arm(sdk.State.ARM_JOINT_STATE)),
)
