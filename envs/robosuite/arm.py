"""One Panda of robosuite: where it is, and what a commanded pose is in its own action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.poses import compose, invert, pose
from xpl.rotation import from_matrix
from xpl.simulator.pose_deltas import MEASURED, PoseDeltas, clip

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SCALE = np.array([0.05, 0.05, 0.05, 0.5, 0.5, 0.5])  # m and rad that an action of 1 is; a test reads the controller's
_STROKE = 0.08  # m between the fingers when they are open
_LINK_TO_FLANGE = np.array([0.0, 0.0, 0.107, 1.0, 0.0, 0.0, 0.0])  # of Franka's last joint
_HAND = np.array([0.0, 0.0, 0.0, np.cos(np.pi / 8), 0.0, 0.0, -np.sin(np.pi / 8)])  # Franka's hand in its flange


class Arm:
    """One of robosuite's robots.

    Attributes:
        prefix: of its keys in the standard.
        has_fingers: whether something opens and closes; a wiper and a peg do not.

    Args:
        prefix: see above.
        number: robosuite's, of the robot.
        counted_from: what a change counts from (`xpl.simulator.pose_deltas.PoseDeltas`).
    """

    def __init__(self, prefix: str, number: int, counted_from: str) -> None:
        self.prefix, self._number = prefix, number
        self._changes = PoseDeltas(counted_from)

    def find(self, env: Any) -> None:
        """Read the indices of a loaded model."""
        self._sim, robot = env.sim, env.robots[self._number]
        model = self._sim.model
        self._link = model.body_name2id(f"robot{self._number}_link7")
        base = model.body_name2id(f"robot{self._number}_base")
        self._to_base = rotation.conjugate(np.array(self._sim.data.body_xquat[base]))
        self._site = robot.eef_site_id["right"]
        self._tool = compose(invert(self._flange()), self._grip())
        self.has_fingers = bool(robot.gripper["right"].dof)

    def begin(self, flange: NDArray[np.float64]) -> None:
        """Begin an episode at the pose that a policy observes first."""
        self._changes.begin(self.reached(flange.astype(np.float32)))

    def state(self, obs: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
        """Return joints (rad), opening, the pose of the flange and of the point between the fingers."""
        opening = 0.0
        if self.has_fingers:
            left, right = obs[f"robot{self._number}_gripper_qpos"]
            opening = float(np.clip((left - right) / _STROKE, 0.0, 1.0))
        flange, self._present = self._flange(), self._grip()
        turned = compose(flange, _HAND)[spec.POSITION_DIM :]
        return {
            spec.State.ARM_JOINT_STATE: obs[f"robot{self._number}_joint_pos"],
            spec.State.EE_JOINT_STATE: np.array([opening]),
            spec.State.EE_POSE: flange,
            spec.State.TCP_POSE: pose(self._present[: spec.POSITION_DIM], turned),
        }

    def reached(self, flange: Any) -> NDArray[np.float64]:
        """Return where the point is that robosuite's controller moves, for a pose of the flange."""
        return compose(flange, self._tool)

    def change(self, flange: Any) -> tuple[NDArray[np.float64], float]:
        """Return robosuite's six numbers for a commanded pose of the flange, and how far the largest was past 1."""
        change = self._changes.delta(self.reached(flange), self._present)
        parts = [rotation.rotate(self._to_base, part) for part in np.split(change, 2)]
        command = (np.concatenate(parts) / _SCALE).tolist()
        move, past = clip(command, together=self._changes.counted_from == MEASURED)
        return np.array(move), past

    def _flange(self) -> NDArray[np.float64]:
        data = self._sim.data
        return compose(pose(data.body_xpos[self._link], data.body_xquat[self._link]), _LINK_TO_FLANGE)

    def _grip(self) -> NDArray[np.float64]:
        data = self._sim.data
        return pose(data.site_xpos[self._site], from_matrix(data.site_xmat[self._site].reshape(3, 3)))
