"""An expert for gym-aloha's tasks: waypoints computed from the objects' poses, and inverse kinematics in between.

gym-aloha has none. ACT's scripts moved mocap-driven hands, in a simulation of its own, and replayed the joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.kinematics import Chain
from xpl.poses import invert, pose, transform

if TYPE_CHECKING:
    from numpy.typing import NDArray

OPEN, SHUT = 1.0, 0.0
_LEVEL, _STEEP = 0.0, 1.05  # rad below level
_PLAIN, _ROLLED = 0.0, np.pi / 2  # rad


@dataclass(frozen=True)
class Point:
    """A waypoint of one arm's fingertips.

    Attributes:
        step: control step of the episode.
        place: position between the fingers, in the world, m.
        down: pitch of the hand below horizontal, rad.
        roll: about the direction of the hand, rad.
        opening: of the gripper.
    """

    step: int
    place: Sequence[float] | NDArray[np.float64]
    down: float
    roll: float
    opening: float


class Expert:
    """Plans once, when an episode begins, and returns each step's joints.

    Args:
        chain: of one arm; both are alike.
        bases: pose (7,) of each arm's base by "left" and "right".
        task: "transfer_cube" or "insertion".
    """

    def __init__(self, chain: Chain, bases: Mapping[str, NDArray[np.float64]], task: str) -> None:
        self._chain, self._bases = chain, bases
        self._plan = {"transfer_cube": transfer, "insertion": insertion}[task]

    def begin(self, state: Mapping[str, NDArray[np.float64]], objects: Mapping[str, NDArray[np.float64]]) -> None:
        """Plan an episode from the robot's first state and the objects' poses."""
        self._step, self._ways = 0, {}
        for arm, points in self._plan(objects).items():
            first = [state[f"{arm}_{key}"] for key in (spec.State.ARM_JOINT_STATE, spec.State.EE_JOINT_STATE)]
            self._ways[arm] = [(0, np.concatenate(first)), *((point.step, self._row(arm, point)) for point in points)]

    def advance(self) -> None:
        """Go on to the next step."""
        self._step += 1

    def action(self) -> dict[str, NDArray[np.float64]]:
        """Return the action of the present step; repeated calls return the same."""
        rows = {arm: _between(way, self._step + 1) for arm, way in self._ways.items()}
        joints = {f"{arm}_{spec.State.ARM_JOINT_STATE}": row[:-1] for arm, row in rows.items()}
        return {**joints, **{f"{arm}_{spec.State.EE_JOINT_STATE}": row[-1:] for arm, row in rows.items()}}

    def _row(self, arm: str, point: Point) -> NDArray[np.float64]:
        """Return joints and opening (dof + 1,) of a way point; the hand looks away from its base: no joint twists."""
        base = self._bases[arm]
        position = transform(invert(base), point.place)
        ahead = float(np.arctan2(position[1], position[0]))
        turn = rotation.from_axis_angle([0.0, 0.0, ahead])
        for part in ([0.0, point.down, 0.0], [point.roll, 0.0, 0.0]):
            turn = rotation.multiply(turn, rotation.from_axis_angle(part))
        assert self._chain.home is not None  # noqa: S101 - the standard gives it
        start = self._chain.home.copy()
        start[0], start[-1] = ahead, point.roll
        joints = self._chain.search(self._chain.flange_from_tcp(pose(position, turn)), start).joints
        return np.append(joints, point.opening)


def _between(way: Sequence[tuple[int, NDArray[np.float64]]], step: int) -> NDArray[np.float64]:
    """Return joints and opening at a step, eased between two way points; after the last one, that."""
    for (since, before), (until, after) in pairwise(way):
        if step < until:
            share = (step - since) / (until - since)
            return before + share * share * (3.0 - 2.0 * share) * (after - before)
    return way[-1][1]


def transfer(objects: Mapping[str, NDArray[np.float64]]) -> dict[str, list[Point]]:
    """Return the way points: the right hand takes the cube to the middle, and the left one, rolled, takes it there."""
    x, y = objects["box"][:2]
    meeting = np.array([0.05, 0.5, 0.3])
    right = [*_grasp_points(x, y), Point(190, meeting, _LEVEL, _PLAIN, SHUT)]
    left = [
        Point(140, (-0.25, 0.5, 0.3), _LEVEL, _ROLLED, OPEN),
        Point(190, meeting - [0.15, 0.0, 0.0], _LEVEL, _ROLLED, OPEN),
        Point(235, meeting - [0.01, 0.0, 0.0], _LEVEL, _ROLLED, OPEN),
        Point(260, meeting - [0.01, 0.0, 0.0], _LEVEL, _ROLLED, SHUT),
    ]
    return {"left": left, "right": right}


def insertion(objects: Mapping[str, NDArray[np.float64]]) -> dict[str, list[Point]]:
    """Return the way points: each hand lifts its part, tilted as it took it, and they push both together."""
    # The middle of the peg lies 5 mm below the fingers that hold it, and that of the socket 7 mm above.
    parts = {"left": ("socket", -1.0, 0.194), "right": ("peg", 1.0, 0.206)}
    ways = {}
    for arm, (name, side, height) in parts.items():
        apart, together = (0.19 * side, 0.5, height), (0.042 * side, 0.5, height)
        lifted = [Point(190, apart, _STEEP, _PLAIN, SHUT), Point(280, together, _STEEP, _PLAIN, SHUT)]
        ways[arm] = [*_grasp_points(*objects[name][:2]), *lifted]
    return ways


def _grasp_points(x: float, y: float) -> list[Point]:
    """Return the way points of a hand that takes what lies on the table."""
    return [
        Point(60, (x, y, 0.12), _STEEP, _PLAIN, OPEN),
        Point(95, (x, y, 0.015), _STEEP, _PLAIN, OPEN),
        Point(120, (x, y, 0.015), _STEEP, _PLAIN, SHUT),
    ]
