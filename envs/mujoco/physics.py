"""A compiled scene in motion: what tasks, control and observations may read and set, by name and by arm."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.poses import compose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .arms import ArmNames
    from .scene import Scene


# All that the future motion depends on; nothing here applies outside forces, which would belong to it.
_STATE = int(
    mujoco.mjtState.mjSTATE_FULLPHYSICS
    | mujoco.mjtState.mjSTATE_WARMSTART
    | mujoco.mjtState.mjSTATE_CTRL
    | mujoco.mjtState.mjSTATE_EQ_ACTIVE
    | mujoco.mjtState.mjSTATE_MOCAP_POS
    | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)


@dataclass(frozen=True)
class _ArmIndex:
    """Where one arm's values are in the model's arrays."""

    joints: NDArray[np.intp]
    actuators: NDArray[np.intp]
    targets: NDArray[np.intp]
    finger: int
    fingers: NDArray[np.intp]
    travel: float
    finger_bodies: tuple[int, int]
    root: int
    flange_body: int
    tcp_offset: NDArray[np.float64]


class Physics:
    """State and motion of a scene.

    Reading costs as little as NumPy allows, because a control step's ten physics steps take a tenth of a millisecond:
    names are looked up once, MuJoCo's arrays are held, and contacts are listed once per control step.

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
        self._bodies = {self.model.body(index).name: index for index in range(self.model.nbody)}
        self._body_dofs: list[int] = self.model.body_dofadr.tolist()
        self._body_slides = [self.model.jnt_qposadr[joint] for joint in self.model.body_jntadr]
        self._body_roots: list[int] = self.model.body_rootid.tolist()
        self._geom_bodies = np.array(self.model.geom_bodyid)
        # Views of MuJoCo's memory: they follow the state.
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._ctrl, self._act = self.data.ctrl, self.data.act
        self._xpos, self._xquat, self._xmat = self.data.xpos, self.data.xquat, self.data.xmat
        self._actuators = np.concatenate([arm.actuators for arm in self._arms])
        self._targets = np.concatenate([arm.targets for arm in self._arms])
        self._timestep = float(self.model.opt.timestep)
        self._scales = np.concatenate([[*np.ones(len(arm.joints)), arm.travel] for arm in self._arms])
        self._flanges = np.array([arm.flange_body for arm in self._arms])
        self._tcps = np.array([self.model.site(names.tcp).id for names in scene.arms])
        self._site_xpos = self.data.site_xpos
        self._tcp_turns = np.stack(
            [rotation.multiply(np.eye(4), arm.tcp_offset[spec.POSITION_DIM :]).T for arm in self._arms]
        )
        self._state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        self._contacts: dict[int, set[int]] | None = None

    # -- arms ----------------------------------------------------------------------------------------------------------

    @property
    def arm_count(self) -> int:
        """Number of arms."""
        return len(self._arms)

    @property
    def bodies(self) -> list[str]:
        """Names of all bodies, by MuJoCo's id; the first is the world."""
        return list(self._bodies)

    def joints(self, arm: int) -> NDArray[np.float64]:
        """Return the joint angles (dof,) of an arm, rad."""
        angles: NDArray[np.float64] = self._qpos[self._arms[arm].joints]
        return angles

    def opening(self, arm: int) -> float:
        """Return how far a gripper is open, 0 closed to 1 open, kept within that range."""
        index = self._arms[arm]
        return min(1.0, max(0.0, float(self._qpos[index.finger]) / index.travel))

    def flange(self, arm: int) -> NDArray[np.float64]:
        """Return the pose (7,) of an arm's flange in the world.

        The quaternion is a continuous function of the joint angles: its sign does not jump in the course of a motion.
        """
        return self._pose(self._arms[arm].flange_body)

    def flanges(self) -> NDArray[np.float64]:
        """Return the poses (arms, 7) of all flanges in the world."""
        return np.concatenate((self._xpos.take(self._flanges, 0), self._xquat.take(self._flanges, 0)), axis=1)

    def tcp(self, arm: int) -> NDArray[np.float64]:
        """Return the pose (7,), in the world, of the point between an arm's fingertips."""
        return compose(self.flange(arm), self._arms[arm].tcp_offset)

    def tcps(self) -> NDArray[np.float64]:
        """Return the poses (arms, 7), in the world, of the points between the fingertips."""
        # A product of quaternions is linear in the first one, and what it is multiplied with never changes.
        turns = (self._tcp_turns * self._xquat[self._flanges][:, None]).sum(axis=2)
        return np.concatenate((self._site_xpos[self._tcps], turns), axis=1)

    def place(self, arm: int, joints: NDArray[np.float64], opening: float) -> None:
        """Put an arm at rest into a configuration (joint angles in rad, 0 closed to 1 open) and hold it there."""
        index = self._arms[arm]
        self._qpos[index.joints] = joints
        self._qpos[index.fingers] = opening * index.travel
        self._act[index.targets] = [*joints, opening * index.travel]

    # -- objects -------------------------------------------------------------------------------------------------------

    def body_pose(self, name: str) -> NDArray[np.float64]:
        """Return the pose (7,) of a body in the world."""
        return self._pose(self._bodies[name])

    def position(self, name: str) -> list[float]:
        """Return the place [x, y, z] of a body in the world, m."""
        position: list[float] = self._xpos[self._bodies[name]].tolist()
        return position

    def axes(self, name: str) -> list[float]:
        """Return the rotation matrix of a body in the world, row by row: nine numbers."""
        rows: list[float] = self._xmat[self._bodies[name]].tolist()
        return rows

    def position_in(self, name: str, frame: str) -> tuple[float, float, float]:
        """Return the place of a body in the frame of another one, m."""
        (x, y, z), (a, b, c) = self.position(name), self.position(frame)
        x, y, z = x - a, y - b, z - c
        turn = self.axes(frame)
        return (
            turn[0] * x + turn[3] * y + turn[6] * z,
            turn[1] * x + turn[4] * y + turn[7] * z,
            turn[2] * x + turn[5] * y + turn[8] * z,
        )

    def slide(self, name: str) -> float:
        """Return how far a body with one joint has moved along it, m."""
        return float(self._qpos[self._body_slides[self._bodies[name]]])

    def body_speed(self, name: str) -> tuple[float, float]:
        """Return how fast a free body moves (m/s) and turns (rad/s)."""
        first = self._body_dofs[self._bodies[name]]
        x, y, z, a, b, c = self._qvel[first : first + 6].tolist()
        return math.sqrt(x * x + y * y + z * z), math.sqrt(a * a + b * b + c * c)

    def grasped(self, name: str, arm: int) -> bool:
        """Return whether both fingers of an arm touch a body."""
        touching = self._touching(name)
        return all(finger in touching for finger in self._arms[arm].finger_bodies)

    def touched(self, name: str, arm: int) -> bool:
        """Return whether any part of an arm touches a body."""
        root = self._arms[arm].root
        return any(self._body_roots[body] == root for body in self._touching(name))

    # -- time ----------------------------------------------------------------------------------------------------------

    def step(self, count: int) -> None:
        """Advance by `count` time steps, then bring poses up to date with the new state."""
        mujoco.mj_step(self.model, self.data, count)
        self._arrive()

    def drive(self, targets: NDArray[np.float64], count: int) -> None:
        """Advance by `count` time steps while the position targets of all arms move evenly to new ones.

        Targets that jump once in a control step shake what a gripper holds out of it. The actuators hold their targets
        and are commanded the speed of these (see `arms`), so that MuJoCo moves them.

        Args:
            targets: (D,) joint angles (rad) and gripper (0 closed, 1 open), arm after arm.
            count: time steps.
        """
        change = targets * self._scales - self._act.take(self._targets)
        self._ctrl[self._actuators] = change / (count * self._timestep)
        self.step(count)

    def settle(self, count: int) -> None:
        """Let objects come to rest before an episode begins."""
        mujoco.mj_forward(self.model, self.data)
        self.step(count)
        self.data.time = 0.0
        self.changed()

    def changed(self) -> None:
        """Take note of a state that was set and not stepped to."""
        mujoco.mj_getState(self.model, self.data, self._state, _STATE)
        self._contacts = None

    def is_finite(self) -> bool:
        """Return whether the state is still a number everywhere, and none beyond all measure."""
        with np.errstate(over="ignore"):  # such a measure is what is asked for, and nothing to warn of
            return math.isfinite(self._state.dot(self._state))

    def digest_into(self, digest: hashlib._Hash) -> None:
        """Feed everything that determines the future motion to a running digest."""
        digest.update(self._state.data)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _arrive(self) -> None:
        # mj_step leaves poses as they were before its last integration.
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self.changed()

    def _pose(self, body: int) -> NDArray[np.float64]:
        return np.concatenate((self._xpos[body], self._xquat[body]))

    def _touching(self, name: str) -> set[int]:
        """Return the bodies, but for the world, in contact with a body."""
        if self._contacts is None:
            self._contacts = {}
            for one, other in self._geom_bodies.take(self.data.contact.geom).tolist():
                if one and other:  # most contacts are those of things with the table
                    self._contacts.setdefault(one, set()).add(other)
                    self._contacts.setdefault(other, set()).add(one)
        return self._contacts.get(self._bodies[name], set())

    def _index(self, names: ArmNames) -> _ArmIndex:
        model = self.model
        fingers = [model.joint(name) for name in names.fingers]
        left, right = (model.body(name).id for name in names.fingers)
        flange = int(model.site_bodyid[model.site(names.flange).id])
        actuators = np.array([model.actuator(name).id for name in (*names.joints, names.gripper)])
        return _ArmIndex(
            joints=np.array([model.joint(name).qposadr[0] for name in names.joints]),
            actuators=actuators,
            targets=model.actuator_actadr[actuators],
            finger=int(fingers[0].qposadr[0]),
            fingers=np.array([finger.qposadr[0] for finger in fingers]),
            travel=float(fingers[0].range[1]),
            finger_bodies=(left, right),
            root=int(model.body_rootid[flange]),
            flange_body=flange,
            tcp_offset=names.tcp_offset,
        )
