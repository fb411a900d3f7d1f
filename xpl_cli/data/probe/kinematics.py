"""Batched forward kinematics; which robot, joint order, point and frame explain recorded poses."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import get_embodiment, poses, robots, rotation
from xpl.conventions import frame as frames
from xpl.conventions.point import tool
from xpl.convert import ConversionError
from xpl.embodiment import UnknownEmbodimentError, embodiment_names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl import Embodiment

FITS_MM: Final = 5.0
"""Errors up to which a robot explains positions: calibration, rounding and clock skew."""
_FEW: Final = 12
_PLENTY: Final = 120
_STILL: Final = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
_MOST_PERMUTED: Final = 7


@dataclass(frozen=True)
class KinematicFit:
    """One hypothesis on recorded joints and positions, with its error.

    Attributes:
        robot: name of the embodiment.
        side: arm, as the standard names it.
        order: which of the recorded numbers is which joint of the embodiment: joint j is number order[j].
        point, frame, length: of the position.
        error: root mean square, mm.
    """

    robot: str
    side: str
    order: tuple[int, ...]
    point: str
    frame: str
    length: str
    error: float


def flange(data: Mapping[str, Any], joints: np.ndarray) -> np.ndarray:
    """Return poses (..., 7) of the flange in the arm's base, of joint angles (..., dof), rad."""
    at = np.broadcast_to(_STILL, (*joints.shape[:-1], 7))
    for index, (origin, axis) in enumerate(_frames(data["name"])):
        turned = rotation.from_axis_angle(joints[..., index, None] * axis)
        at = poses.compose(poses.compose(at, origin), np.concatenate([np.zeros((*turned.shape[:-1], 3)), turned], -1))
    return at


@cache
def _frames(name: str) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    data = get_embodiment(name).data
    return tuple(
        (poses.pose(one["origin"]["xyz"], rotation.from_rpy(one["origin"]["rpy"])), np.array(one["axis"], np.float64))
        for one in data["arm"]["joints"]
    )


def candidates(dof: int, name: str | None) -> list[Embodiment]:
    """Return the robots with kinematics and `dof` joints; only the one called `name`, if given."""
    names = [name] if name else embodiment_names()
    matching = []
    for one in names:
        try:
            robot = get_embodiment(one)
        except UnknownEmbodimentError:
            continue
        if robots.has_frames(robot.data) and robot.arms[0].dof == dof:
            matching.append(robot)
    return matching


def tool_offsets(robot: Embodiment, side: str) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
    """Return for each point and frame of the standard the transforms before and after the arm's flange pose."""
    offsets = {}
    for point, frame in itertools.product(("flange", "tcp"), ("world", "base")):
        try:
            outer = frames.mount(robot, side) if frame == "world" else _STILL
            inner = tool(robot) if point == "tcp" else _STILL
        except ConversionError:
            continue
        offsets[point, frame] = (outer, inner)
    return offsets


def kinematic_fits(
    joints: np.ndarray, position: np.ndarray, names: list[Embodiment], *, orders: bool = False
) -> list[KinematicFit]:
    """Fit joints (N, dof) rad to positions (N, 3) for every hypothesis, best first.

    Args:
        joints: of the arm.
        position: recorded with them.
        names: robots.
        orders: whether to try other joint orders than the embodiment's.
    """
    dof = joints.shape[1]
    plain = tuple(range(dof))
    few = np.linspace(0, len(joints) - 1, _PLENTY).astype(int)
    fits = [one for robot in names for one in _fits_of_orders(robot, joints[few], position[few], np.array([plain]))]
    fits.sort(key=lambda one: one.error)
    if orders and dof <= _MOST_PERMUTED:
        every = np.array(list(itertools.permutations(range(dof))))
        sparse = np.linspace(0, len(joints) - 1, _FEW).astype(int)
        for robot in names:
            near = sorted(_fits_of_orders(robot, joints[sparse], position[sparse], every), key=lambda one: one.error)[
                :24
            ]
            best_orders = np.array(list({one.order for one in near}))
            fits += _fits_of_orders(robot, joints[few], position[few], best_orders)
        fits.sort(key=lambda one: one.error)
    return fits


def _fits_of_orders(
    robot: Embodiment, joints: np.ndarray, position: np.ndarray, orders: np.ndarray
) -> list[KinematicFit]:
    """Return the fits of some joint orders of a robot, for each side, point, frame and length unit."""
    ends = flange(robot.data, np.moveaxis(joints[:, orders], 0, 1))
    fits = []
    for side in robot.data["arms"]:
        for (point, frame), (outer, inner) in tool_offsets(robot, side).items():
            if frame == "base" and side != robot.data["arms"][0]:
                continue  # the base frame does not depend on the side
            there = poses.compose(poses.compose(outer, ends), inner)[..., :3]
            for length, factor in frames.UNITS.items():
                off = there - position / factor
                errors = 1000 * np.sqrt((off * off).sum(-1).mean(-1))
                best = range(len(orders)) if len(orders) == 1 else np.argsort(errors)[:24]
                fits += [
                    KinematicFit(robot.name, side, tuple(map(int, orders[k])), point, frame, length, float(errors[k]))
                    for k in best
                ]
    return fits


def robot_at_home(rows: Sequence[np.ndarray]) -> str | None:
    """Return the robot whose home pose most episodes start at, within 0.05 rad; None if there is none."""
    first = np.stack([episode[0] for episode in rows])
    for unit in (1.0, np.pi / 180):
        for robot in candidates(first.shape[1], None):
            home = robot.arms[0].home
            if home is None or np.linalg.norm(home) < 0.3:
                continue
            if (np.abs(first * unit - home).max(1) < 0.05).mean() > 0.5:
                return robot.name
    return None
