"""The robot cell for programs: hands that move through the world, and the ground truth of objects.

A program is a generator: it sets targets, and every ``yield`` is one control step. Before it goes on, the cell shows
the newest observation, so that a program can look again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.kinematics import Chain
from xpl.poses import compose, invert, pose, transform

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Program = Iterator[None]

UPRIGHT = np.zeros(spec.POSITION_DIM)
"""No lean: fingers that point straight down."""

_TRAVEL, _TURN = 0.013, 0.055  # m and rad of one control step, on average over a motion
_SHORTEST = 4  # control steps
_ARRIVED, _ARRIVED_TURN, _PATIENCE = 0.003, 0.03, 12  # m, rad, and control steps waited for it at most
_COARSE = 6.0  # control steps between the points at which a motion is predicted


class Hand:
    """One arm with its gripper, moved by the point between its fingertips.

    Args:
        data: the embodiment's entry in the spec.
        base: pose (7,) of the arm's base in the world.
        joints: joint angles (dof,) at the beginning, rad.
        opening: of the gripper, 0 closed, 1 open.

    Attributes:
        target: pose (7,) of the tcp in the world that is commanded now.
        opening: gripper command, 0 closed, 1 open.
        joints: joint angles (dof,) that reach `target`.
        measured: joint angles (dof,) as they are.
    """

    def __init__(self, data: Mapping[str, Any], base: np.ndarray, joints: np.ndarray, opening: float) -> None:
        self.chain = Chain.from_embodiment(data)
        self.base = base
        self.joints = np.clip(joints, self.chain.lower, self.chain.upper)
        self.measured = self.joints
        self.opening = opening
        self.target = compose(base, self.chain.tcp(self.joints))
        effector = data["end_effector"]
        # The axes are given in the flange; the tcp's frame may be turned in it, as Franka's is.
        turned = rotation.to_matrix(rotation.from_rpy(effector["tcp"]["rpy"]))
        self._tool = turned.T @ _axes(np.array(effector["forward_axis"]), np.array(effector["slide_axis"]))

    def flange(self) -> np.ndarray:
        """Return the pose (7,) of the flange in the world that goes with `target`."""
        return self.chain.flange_from_tcp(self.target)

    def follow(self) -> None:
        """Solve for the joint angles of `target`, near those of the step before."""
        self.joints = self._solve(self.target, self.joints)[0]

    def pointing_down(self, position: ArrayLike, yaw: float, lean: ArrayLike = UPRIGHT) -> np.ndarray:
        """Return the tcp pose (7,) at a position (3,), fingers down, sliding in the horizontal direction `yaw`, rad.

        `lean` (3,) is a horizontal vector to which the fingertips are tipped, by its length in rad.
        """
        slide = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        down = rotation.from_matrix(_axes(np.array([0.0, 0.0, -1.0]), slide) @ self._tool.T)
        x, y, _ = np.asarray(lean)
        return pose(position, rotation.multiply(rotation.from_axis_angle([y, -x, 0.0]), down))

    def easiest_yaw(self, waypoints: Sequence[tuple[ArrayLike, float]], lean: ArrayLike = UPRIGHT) -> float:
        """Return what to add to the yaw of all waypoints, 0 or a half turn either way.

        A parallel gripper grasps the same either way; the choice decides whether the wrist can follow to the end.

        Args:
            waypoints: positions (3,) and yaws that are visited in turn.
            lean: see `pointing_down`.
        """
        candidates = []
        for turn in (0.0, math.pi, -math.pi):
            at, joints, worst = self.target, self.joints, 0.0
            for position, yaw in waypoints:
                goal = self.pointing_down(position, yaw + turn, lean)
                joints, error = self._foresee(at, goal, joints)
                at, worst = goal, max(worst, error)
            effort = float(np.max(np.abs(joints - self.joints)))
            candidates.append((round(worst, 3), effort, turn))
        return min(candidates)[2]

    def move(self, goal: np.ndarray, speed: float = 1.0) -> Program:
        """Move the tcp on a straight line to a pose (7,), starting and ending gently, and let the arm catch up.

        A heavy arm is some control steps behind; one that something holds up is waited for a moment only.
        """
        start = self.target
        steps = max(_SHORTEST, math.ceil(_duration(start, goal) / speed))
        for step in range(1, steps + 1):
            part = step / steps
            self.target = _between(start, goal, part * part * (3.0 - 2.0 * part))
            yield
        for _ in range(_PATIENCE):
            if self._is_there():
                break
            yield

    def shift(self, offset: ArrayLike, speed: float = 1.0) -> Program:
        """Move the tcp by an offset (3,) in the world, keeping its rotation."""
        moved = self.target.copy()
        moved[: spec.POSITION_DIM] += np.asarray(offset)
        return self.move(moved, speed)

    def grip(self, opening: float, steps: int) -> Program:
        """Command the gripper and give it time."""
        self.opening = opening
        yield from pause(steps)

    def _is_there(self) -> bool:
        # Not `target` itself, which may be out of reach.
        split, is_at, goal = spec.POSITION_DIM, self.chain.tcp(self.measured), self.chain.tcp(self.joints)
        off = float(np.sqrt(np.sum((is_at[:split] - goal[:split]) ** 2)))
        return off < _ARRIVED and float(rotation.angle_between(is_at[split:], goal[split:])) < _ARRIVED_TURN

    def _foresee(self, start: np.ndarray, goal: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the joints after a straight motion, as `follow` would find them, and the error that is left.

        Following keeps to one branch: it can end at a joint's limit where another branch would reach the goal.
        """
        error, steps = 0.0, math.ceil(_duration(start, goal) / _COARSE) or 1
        for step in range(1, steps + 1):
            joints, error = self._solve(_between(start, goal, step / steps), joints)
        return joints, error

    def _solve(self, target: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, float]:
        flange = compose(invert(self.base), self.chain.flange_from_tcp(target))
        solution = self.chain.solve(flange, start)
        return solution.joints, solution.position_error + 0.2 * solution.rotation_error


class Cell:
    """All hands, and the state of the world.

    Args:
        hands: in packing order.
        truth: the `privileged` map of the newest observation.
    """

    def __init__(self, hands: Sequence[Hand], truth: Mapping[str, Any]) -> None:
        self.hands = tuple(hands)
        self.truth = truth

    def see(self, truth: Mapping[str, Any], joints: np.ndarray) -> None:
        """Update from an observation: its `privileged` map and the joints (D,) of all arms, with grippers."""
        self.truth, at = truth, 0
        for hand in self.hands:
            hand.measured = joints[at : at + hand.chain.dof]
            at += hand.chain.dof + 1

    @property
    def table(self) -> float:
        """Height of the table, m."""
        return float(self.truth["table_top"])

    def nearest(self, place: ArrayLike) -> Hand:
        """Return the hand whose base is nearest to a place in the horizontal plane; only x and y count."""
        target = np.asarray(place)[:2]
        return min(self.hands, key=lambda hand: float(np.sum((hand.base[:2] - target) ** 2)))

    def object_position(self, name: str) -> np.ndarray:
        """Return the current position of an object's centre, (3,)."""
        return np.array(self.truth["objects"][name]["pose"], dtype=np.float64)[: spec.POSITION_DIM]

    def object_yaw(self, name: str) -> float:
        """Return the direction of an object's x axis in the horizontal plane, rad."""
        quaternion = np.array(self.truth["objects"][name]["pose"], dtype=np.float64)[spec.POSITION_DIM :]
        along = rotation.rotate(quaternion, [1.0, 0.0, 0.0])
        return math.atan2(float(along[1]), float(along[0]))

    def object_axis(self, name: str) -> np.ndarray:
        """Return the direction (3,) of an object's z axis, which is up while it stands."""
        quaternion = np.array(self.truth["objects"][name]["pose"], dtype=np.float64)[spec.POSITION_DIM :]
        return rotation.rotate(quaternion, [0.0, 0.0, 1.0])

    def half_size(self, name: str) -> np.ndarray:
        """Return half the extents of an object, (3,), m."""
        return np.array(self.truth["objects"][name]["half_size"], dtype=np.float64)

    def object_points(self, name: str, points: str) -> np.ndarray:
        """Return named points (n, 3) of an object, which are known in its frame, in the world."""
        entry = self.truth["objects"][name]
        return transform(np.array(entry["pose"], dtype=np.float64), np.array(entry[points], dtype=np.float64))

    def goal_position(self, name: str) -> np.ndarray:
        """Return the position of a goal, (3,)."""
        return np.array(self.truth["goals"][name]["position"], dtype=np.float64)

    def goal_yaw(self, name: str) -> float:
        """Return the direction of a goal's x axis in the horizontal plane, rad."""
        return float(self.truth["goals"][name]["yaw"])


def pause(steps: int) -> Program:
    """Keep all targets for some control steps."""
    for _ in range(steps):
        yield


def together(*programs: Program) -> Program:
    """Run programs of different hands at the same time, until all have ended."""
    running = list(programs)
    while running:
        running = [program for program in running if next(program, _ENDED) is not _ENDED]
        if running:
            yield


_ENDED = object()


def _duration(start: np.ndarray, goal: np.ndarray) -> float:
    """Return how many control steps a motion between two poses (7,) takes at the usual pace."""
    split = spec.POSITION_DIM
    travel = float(np.sqrt(np.sum((goal[:split] - start[:split]) ** 2)))
    turn = float(rotation.angle_between(start[split:], goal[split:]))
    return max(travel / _TRAVEL, turn / _TURN)


def _between(start: np.ndarray, goal: np.ndarray, part: float) -> np.ndarray:
    """Return the pose (7,) that is `part` of the way, 0 to 1, between two."""
    split = spec.POSITION_DIM
    place = start[:split] + part * (goal[:split] - start[:split])
    return pose(place, rotation.slerp(start[split:], goal[split:], part))


def _axes(forward: np.ndarray, slide: np.ndarray) -> np.ndarray:
    """Return the axes (3, 3) of a tool as columns: forward, slide, and across both."""
    return np.stack([forward, slide, np.cross(forward, slide)], axis=-1)
