"""One task of robosuite in its own simulator; its numbers are converted to the standard's here and nowhere else."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.environment import Episode, Setup
from xpl.episode import SUCCESS_SCORE, Simulated
from xpl.rendering import choose_opengl
from xpl.simulator.pose_deltas import COMMANDED, MEASURED

from .arm import Arm
from .cameras import CameraRenderer

if TYPE_CHECKING:
    from numpy.typing import NDArray

ACTION_RANGE = "action_range"
_SLACK = 1e-4  # of the range of an action: rounding of float32 poses is no violation
_DELTA, _ABSOLUTE = "delta", "absolute"


class RobosuiteEpisode(Episode):
    """An episode of a task with one Panda, or with two that face each other.

    An action of robosuite moves the point between the fingers by up to 5 cm along each axis of the arm's base, and
    turns it by a rotation vector of the base of up to 0.5 rad; both count from where it is. The last number opens (-1)
    or closes (+1) the fingers. Its first robot is the right arm, as in its own robots of two arms.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        choose_opengl()
        logging.disable(logging.WARNING)  # it warns of missing libraries, and logs the assets of each episode
        import robosuite
        from robosuite.controllers import load_composite_controller_config

        logging.disable(logging.NOTSET)
        logging.getLogger("robosuite_logs").setLevel(logging.ERROR)
        prefixes = tuple(reversed(setup.embodiment.prefixes))
        controller = load_composite_controller_config(controller=None, robot="Panda")
        if setup.setting == _ABSOLUTE:
            controller["body_parts"]["right"].update(input_type="absolute", input_ref_frame="world")
        self._renderer = CameraRenderer(setup)
        self._env = robosuite.make(
            setup.task,
            robots=["Panda"] * len(prefixes),
            controller_configs=controller,
            control_freq=round(setup.frequency),
            ignore_done=True,  # the step limit is that of env.yml
            seed=0,
            **self._renderer.options(),
        )
        self._renderer.prepare(self._env)
        counted = COMMANDED if setup.setting == _DELTA else MEASURED
        self._arms = [Arm(prefix, number, counted) for number, prefix in enumerate(prefixes)]
        self._step = self._absolute_command if setup.setting == _ABSOLUTE else self._delta_command

    def reset(self, seed: int) -> None:
        """Begin an episode; the seed draws all that robosuite draws."""
        # One generator, which everything that draws has: a new one would not reach what was made before.
        self._env.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
        obs = self._env.reset()
        self._success, self._is_over = False, False
        self._last_command: np.ndarray | None = None
        for arm in self._arms:
            arm.find(self._env)
        self._look(obs)
        for arm in self._arms:
            arm.begin(self._state[arm.prefix + spec.State.EE_POSE])

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Return joints (rad), opening, the pose of the flange and of the point between the fingers, of each arm."""
        return self._state

    def step(self, action: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Execute one action step: send each tool to a pose, or as far as the command went on from the one before."""
        parts, corrections = [], {}
        for arm in self._arms:
            move, past = self._step(arm, action[arm.prefix + spec.State.EE_POSE])
            opening = float(action[arm.prefix + spec.State.EE_JOINT_STATE][0])
            parts.append(np.append(move, 1.0 - 2.0 * opening) if arm.has_fingers else move)
            if past > _SLACK:
                corrections[arm.prefix] = {ACTION_RANGE: past}
        self._last_command = np.concatenate(parts)
        obs, _, self._is_over, _ = self._env.step(self._last_command)
        self._success = bool(self._env._check_success())  # noqa: SLF001 - there is no public access
        self._look(obs)
        return corrections

    def score(self) -> float:
        """Return 1 on success, else 0: robosuite's reward is no share of the task."""
        return SUCCESS_SCORE if self._success else 0.0

    def end_reason(self) -> str | None:
        """Return "truncated" where robosuite itself goes no further: Wipe ends when the arm touches the table."""
        return "truncated" if self._is_over else None

    def vision(self) -> dict[str, dict[str, Any]]:
        """Return the pictures of the manifest's cameras, upright."""
        return self._renderer.seen(self._env, self._obs)

    def truth(self) -> dict[str, Any]:
        """Return robosuite's own observation but for its pictures: poses of objects, quaternions [x, y, z, w] there."""
        return {name: value for name, value in self._obs.items() if not name.endswith("_image")}

    def simulated(self) -> Simulated:
        """Return robosuite's own observation, and its last action, its first robot's first."""
        return Simulated(self._obs, self._last_command)

    def close(self) -> None:
        """Release the simulator."""
        self._env.close()

    def _delta_command(self, arm: Arm, target: Any) -> tuple[NDArray[np.float64], float]:
        return arm.change(target)

    def _absolute_command(self, arm: Arm, target: Any) -> tuple[NDArray[np.float64], float]:
        reached = arm.reached(target)
        turn = rotation.to_axis_angle(reached[spec.POSITION_DIM :])
        return np.concatenate([reached[: spec.POSITION_DIM], turn]), 0.0

    def _look(self, obs: Mapping[str, Any]) -> None:
        self._obs = obs
        self._state = {arm.prefix + key: value for arm in self._arms for key, value in arm.state(obs).items()}
