"""A compiled scene in motion: what tasks, control and observations may read and set, by name and by arm."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from xpl.poses import compose, pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .arms import ArmNames
    from .scene import Scene


@dataclass(frozen=True)
class _ArmIndex:
    """Where one arm's values are in the model's arrays."""

    joints: NDArray[np.intp]
    joint_actuators: NDArray[np.intp]
    finger: int
    gripper_actuator: int
    travel: float
    finger_bodies: tuple[int, int]
    root: int
    flange_body: int
    tcp_offset: NDArray[np.float64]


class Physics:
    """State and motion of a scene.

    Args:
        scene: the finished scene; it is compiled here.

    Attributes:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData`; poses are up to date after `step` and `settle`.
        bases: pose (7,) of each arm's base in the world.
        table_top: height of the table, m.
    """

    def __init__(self, scene: Scene) -> None:
        self.model = scene.spec.compile()
        self.data = mujoco.MjData(self.model)
        self.bases = scene.bases
        self.table_top = scene.table_top
        self._arms = tuple(self._index(names) for names in scene.arms)
        self._state_size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION)

    # -- arms ----------------------------------------------------------------------------------------------------------

    @property
    def arm_count(self) -> int:
        """Number of arms."""
        return len(self._arms)

    def joints(self, arm: int) -> NDArray[np.float64]:
        """Return the joint angles (dof,) of an arm, rad."""
        angles: NDArray[np.float64] = self.data.qpos[self._arms[arm].joints]
        return angles

    def opening(self, arm: int) -> float:
        """Return how far a gripper is open, 0 closed to 1 open, kept within that range."""
        index = self._arms[arm]
        return min(1.0, max(0.0, float(self.data.qpos[index.finger]) / index.travel))

    def flange(self, arm: int) -> NDArray[np.float64]:
        """Return the pose (7,) of an arm's flange in the world.

        The quaternion is a continuous function of the joint angles: its sign does not jump in the course of a motion.
        """
        body = self._arms[arm].flange_body
        return pose(self.data.xpos[body], self.data.xquat[body])

    def tcp(self, arm: int) -> NDArray[np.float64]:
        """Return the pose (7,), in the world, of the point between an arm's fingertips."""
        return compose(self.flange(arm), self._arms[arm].tcp_offset)

    def place(self, arm: int, joints: NDArray[np.float64], opening: float) -> None:
        """Put an arm at rest into a configuration and command it to stay there."""
        index = self._arms[arm]
        self.data.qpos[index.joints] = joints
        finger = self.model.jnt_qposadr
        for body in index.finger_bodies:
            self.data.qpos[finger[self.model.body_jntadr[body]]] = opening * index.travel
        self.command(arm, joints, opening)

    def command(self, arm: int, joints: NDArray[np.float64], opening: float) -> None:
        """Set the position targets of an arm's joints (rad) and gripper (0 closed, 1 open)."""
        index = self._arms[arm]
        self.data.ctrl[index.joint_actuators] = joints
        self.data.ctrl[index.gripper_actuator] = opening * index.travel

    # -- objects -------------------------------------------------------------------------------------------------------

    def body_pose(self, name: str) -> NDArray[np.float64]:
        """Return the pose (7,) of a body in the world."""
        body = self.model.body(name).id
        return pose(self.data.xpos[body], self.data.xquat[body])

    def body_speed(self, name: str) -> tuple[float, float]:
        """Return how fast a free body moves (m/s) and turns (rad/s)."""
        first = self.model.body_dofadr[self.model.body(name).id]
        velocity = self.data.qvel[first : first + 6]
        return float(np.sqrt(np.sum(velocity[:3] ** 2))), float(np.sqrt(np.sum(velocity[3:] ** 2)))

    def grasped(self, name: str, arm: int) -> bool:
        """Return whether both fingers of an arm touch a body."""
        return set(self._arms[arm].finger_bodies) <= self._touching(name)

    def touched(self, name: str, arm: int) -> bool:
        """Return whether any part of an arm touches a body."""
        root = self._arms[arm].root
        return any(self.model.body_rootid[body] == root for body in self._touching(name))

    # -- time ----------------------------------------------------------------------------------------------------------

    def step(self, count: int) -> None:
        """Advance by `count` time steps, then bring poses up to date with the new state."""
        mujoco.mj_step(self.model, self.data, count)
        # mj_step leaves poses as they were before its last integration.
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def settle(self, count: int) -> None:
        """Let objects come to rest before an episode begins."""
        mujoco.mj_forward(self.model, self.data)
        self.step(count)
        self.data.time = 0.0

    def is_finite(self) -> bool:
        """Return whether the state is still a number everywhere."""
        return bool(np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all())

    def digest_into(self, digest: hashlib._Hash) -> None:
        """Feed everything that determines the future motion to a running digest."""
        state = np.empty(self._state_size)
        mujoco.mj_getState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        digest.update(state.tobytes())

    # -- inside --------------------------------------------------------------------------------------------------------

    def _touching(self, name: str) -> set[int]:
        """Return the bodies in contact with a body."""
        body = self.model.body(name).id
        pairs = self.model.geom_bodyid[self.data.contact.geom.reshape(-1, 2)]
        ours = pairs[np.any(pairs == body, axis=1)]
        return set(ours.ravel().tolist()) - {body}

    def _index(self, names: ArmNames) -> _ArmIndex:
        model = self.model
        fingers = tuple(model.body(name).id for name in names.fingers)
        flange = int(model.site_bodyid[model.site(names.flange).id])
        finger = model.joint(names.fingers[0])
        return _ArmIndex(
            joints=np.array([model.joint(name).qposadr[0] for name in names.joints]),
            joint_actuators=np.array([model.actuator(name).id for name in names.joints]),
            finger=int(finger.qposadr[0]),
            gripper_actuator=model.actuator(names.gripper).id,
            travel=float(finger.range[1]),
            finger_bodies=(fingers[0], fingers[1]),
            root=int(model.body_rootid[flange]),
            flange_body=flange,
            tcp_offset=names.tcp_offset,
        )
