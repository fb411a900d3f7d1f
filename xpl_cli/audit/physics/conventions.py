"""Poses and angles in another convention than the standard's: what a policy that mistakes one would command.

A policy moves a robot from where it is. So its first action of a chunk is near what the robot is observed at; where it
is far from that, and time and again near the same thing expressed otherwise, the convention is mistaken.
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
    from xpl_cli.audit.physics.loop import Query

_LEAST_QUERIES = 3
_JOINTS_APART, _POSES_APART = 0.1, 0.03  # rad, m: nearer to the observed state, nothing is mistaken
_METRES_PER_RADIAN = 0.1  # how much of a position one radian of a rotation counts
_NEARER = 5.0  # times, in every query


@dataclass(frozen=True)
class Mistake:
    """A convention that is mistaken.

    Attributes:
        key: whose values are, as in an action.
        what: what is commanded in their place.
        advice: what to do.
        observed: what was observed at the first query.
        commanded: what was commanded then.
    """

    key: str
    what: str
    advice: str
    observed: tuple[float, ...]
    commanded: tuple[float, ...]


@dataclass(frozen=True)
class _Convention:
    """Another way to say where an arm is.

    Attributes:
        what, advice: as of `Mistake`.
        said: returns what an action would hold that says so, or None where that cannot be known.
    """

    what: str
    advice: str
    said: Callable[[State, Embodiment, Arm], np.ndarray | None]


def mistakes(robot: Embodiment, action_type: str, queries: Sequence[Query]) -> Iterator[Mistake]:
    """Yield the mistaken convention of every arm in a loop, if one explains all its answers.

    Args:
        robot: the embodiment.
        action_type: joint or end-effector control.
        queries: the questions of one environment, with what was observed.
    """
    if len(queries) < _LEAST_QUERIES:
        return
    kind = sdk.ACTION_KEYS[action_type][0]
    away, apart, known = (
        (_pose_distance, _POSES_APART, _OF_POSES)
        if kind == sdk.State.EE_POSE
        else (_joint_distance, _JOINTS_APART, _OF_JOINTS)
    )
    for arm in robot.arms:
        key = arm.prefix + kind
        commands = [np.asarray(unpack(query.chunk[0], robot, action_type)[key], dtype=np.float64) for query in queries]
        states = [query.state for query in queries]
        right = [away(command, _values(state[key])) for command, state in zip(commands, states, strict=True)]
        if min(right) < apart:
            continue
        for convention in known:
            said = [convention.said(state, robot, arm) for state in states]
            if all(
                value is not None and _NEARER * away(command, value) < distance
                for command, value, distance in zip(commands, said, right, strict=True)
            ):
                observed = tuple(np.round(_values(states[0][key]), 3).tolist())
                commanded = tuple(np.round(commands[0], 3).tolist())
                yield Mistake(key, convention.what, convention.advice, observed, commanded)
                break


def _pose_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Return how far two poses are apart, m."""
    shift = float(np.linalg.norm(first[: sdk.POSITION_DIM] - second[: sdk.POSITION_DIM]))
    turns = [rotation.normalise(pose[sdk.POSITION_DIM :]) for pose in (first, second)]
    return shift + _METRES_PER_RADIAN * float(rotation.angle_between(*turns))


def _joint_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Return how far two configurations are apart, rad."""
    return float(np.abs(first - second).max())


def _values(given: object) -> np.ndarray:
    return np.asarray(given, dtype=np.float64)


def _flange(state: State, arm: Arm) -> np.ndarray:
    return _values(state[arm.prefix + sdk.State.EE_POSE])


def _at_fingertips(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    return _values(state[arm.prefix + sdk.State.TCP_POSE])


def _from_base(state: State, robot: Embodiment, arm: Arm) -> np.ndarray | None:
    try:
        chain = Chain.from_embodiment(robot.data)
    except KinematicsError:
        return None
    return chain.flange(_values(state[arm.prefix + sdk.State.ARM_JOINT_STATE]))


def _fingertips_from_base(state: State, robot: Embodiment, arm: Arm) -> np.ndarray | None:
    base = _from_base(state, robot, arm)
    tool = compose(invert(_flange(state, arm)), _values(state[arm.prefix + sdk.State.TCP_POSE]))
    return None if base is None else compose(base, tool)


def _real_part_last(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    pose = _flange(state, arm)
    return np.concatenate([pose[: sdk.POSITION_DIM], np.roll(pose[sdk.POSITION_DIM :], -1)])


def _in_millimetres(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    pose = _flange(state, arm)
    return np.concatenate([1000 * pose[: sdk.POSITION_DIM], pose[sdk.POSITION_DIM :]])


def _in_degrees(state: State, _robot: Embodiment, arm: Arm) -> np.ndarray | None:
    angles: np.ndarray = np.degrees(_values(state[arm.prefix + sdk.State.ARM_JOINT_STATE]))
    return angles


def _other_arm(kind: str) -> Callable[[State, Embodiment, Arm], np.ndarray | None]:
    def said(state: State, robot: Embodiment, arm: Arm) -> np.ndarray | None:
        others = [other for other in robot.arms if other is not arm]
        return _values(state[others[0].prefix + kind]) if others else None

    return said


_EXCHANGED = "where the other arm is"
_UNEXCHANGE = "keep left and right apart: an action is packed left arm, left gripper, right arm, right gripper"
_OF_POSES = (
    _Convention(
        "the point between the fingertips",
        "command the flange: xpl.kinematics turns one into the other",
        _at_fingertips,
    ),
    _Convention("the flange in the frame of the arm's base", "command poses in the world frame", _from_base),
    _Convention(
        "the point between the fingertips in the frame of the arm's base",
        "command the flange in the world frame",
        _fingertips_from_base,
    ),
    _Convention("the quaternion as [x, y, z, w]", "poses are [x, y, z, qw, qx, qy, qz]", _real_part_last),
    _Convention("positions in millimetres", "positions are in metres", _in_millimetres),
    _Convention(_EXCHANGED, _UNEXCHANGE, _other_arm(sdk.State.EE_POSE)),
)
_OF_JOINTS = (
    _Convention("joint angles in degrees", "joint angles are in radians", _in_degrees),
    _Convention(_EXCHANGED, _UNEXCHANGE, _other_arm(sdk.State.ARM_JOINT_STATE)),
)
