"""Poses of an arm at other points and in other frames: flange or TCP, world or base."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import poses, rotation
from xpl.conventions.frame import mount
from xpl.conventions.point import tool

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

_POSITION = slice(0, spec.POSITION_DIM)
_ROTATION = slice(spec.POSITION_DIM, spec.POSE_DIM)


class PoseFrame:
    """Conversion between the standard's flange pose in the world and a model's point and frame.

    Args:
        embodiment: the robot.
        side: the arm: single, left or right.
        point: flange or tcp.
        frame: world or base.

    Attributes:
        point_and_frame: (point, frame).

    Raises:
        ConversionError: the standard has no transform between the two for this robot.
    """

    def __init__(self, embodiment: Embodiment, side: str, point: str, frame: str) -> None:
        self._inner = poses.pose(np.zeros(3), rotation.identity()) if point == "flange" else tool(embodiment)
        self._outer = poses.pose(np.zeros(3), rotation.identity()) if frame == "world" else mount(embodiment, side)
        self.is_plain = point == "flange" and frame == "world"
        self.point_and_frame = (point, frame)

    def encode(self, flange: np.ndarray) -> np.ndarray:
        """Return the point's pose in the frame, (..., 7), of a flange pose (..., 7) in the world."""
        if self.is_plain:
            return np.asarray(flange, np.float64)
        return poses.compose(poses.compose(poses.invert(self._outer), flange), self._inner)

    def flange_rotation(self, turned: np.ndarray) -> np.ndarray:
        """Return the flange's rotation in the world, (..., 4), of the point's rotation (..., 4) in the frame."""
        turn = rotation.multiply(self._outer[_ROTATION], turned)
        return rotation.multiply(turn, rotation.conjugate(self._inner[_ROTATION]))

    def flange_position(self, position: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return the flange's position (..., 3) in the world, of the point's position and the rotation `turn`."""
        return poses.transform(self._outer, position) - rotation.rotate(turn, self._inner[_POSITION])
