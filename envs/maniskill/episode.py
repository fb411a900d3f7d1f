"""One task of ManiSkill in its own simulator; arm.py and control.py convert its numbers to the standard's."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.environment import Episode, NotInstalledError, Setup
from xpl.episode import SUCCESS_SCORE, Simulated
from xpl.kinematics import Chain
from xpl.poses import compose
from xpl.rendering import VULKAN_COMPLAINTS, choose_vulkan, no_vulkan

from . import planner
from .arm import Arm
from .cameras import CameraRenderer
from .control import control_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PLANNED = "planner"
_ROOM = 400  # steps: ManiSkill's planners need more than its limits for policies, and its own runs of them have none


class ManiSkillEpisode(Episode):
    """An episode of the task `NAME-v1`, in the control mode of action type and setting."""

    def __init__(self, setup: Setup) -> None:
        words = setup.setting.split("_")
        if _PLANNED in words:
            setup = replace(setup, max_steps=max(setup.max_steps, _ROOM))
        super().__init__(setup)
        choose_vulkan()
        import torch
        from gymnasium import make

        importlib.import_module("mani_skill.envs")
        _require_assets(setup)
        self._torch = torch
        controls = [control_of(setup.action_type, words, setup.embodiment.name) for _ in setup.embodiment.arms]
        self._renderer = CameraRenderer(setup, words)
        self._env = self._make_env(make, controls[0].mode)
        agents = getattr(self._env.agent, "agents", [self._env.agent])
        self._arms = [
            Arm(agent, arm.prefix, arm.dof, control)
            for agent, arm, control in zip(agents, setup.embodiment.arms, controls, strict=True)
        ]
        solve = planner.solver(setup.task) if setup.privileged else None
        self._planner = None if solve is None else planner.Planner(solve, self._env)

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        self._torch.manual_seed(seed)  # what a task draws in its steps, it draws from the generator that all share
        self._obs, info = self._env.reset(seed=seed)
        self._random = self._torch.get_rng_state()
        self._success = bool(info.get("success", False))
        self._last_command: np.ndarray | None = None
        for arm in self._arms:
            arm.begin()
        if self._planner is not None:
            self._planner.begin()

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Return joints (rad), opening, the pose of the flange and of the point between the fingers, of each arm."""
        return {f"{arm.prefix}{name}": value for arm in self._arms for name, value in arm.state.items()}

    def step(self, action: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Execute one action step."""
        pairs = [arm.controller_command(_of(arm, action)) for arm in self._arms]
        commands = [command.astype(np.float32) for command, _ in pairs]
        self._last_command = np.concatenate(commands)
        self._torch.set_rng_state(self._random)
        outcome = self._env.step(self._as_agents(commands))
        self._random = self._torch.get_rng_state()
        self._obs = outcome[0]
        self._success = bool(outcome[4]["success"])
        for arm in self._arms:
            arm.look()
        if self._planner is not None:
            self._planner.stepped(outcome)
        return {arm.prefix: corrections for arm, (_, corrections) in zip(self._arms, pairs, strict=True) if corrections}

    def score(self) -> float:
        """Return 1 on success, else 0: rewards of ManiSkill are no share of a task."""
        return SUCCESS_SCORE if self._success else 0.0

    def vision(self) -> dict[str, dict[str, Any]]:
        """Return the pictures of the manifest's cameras that the task has."""
        return self._renderer.seen(self._env)

    def truth(self) -> dict[str, Any]:
        """Return ManiSkill's own state observation: poses of objects and goals, [x, y, z, w, i, j, k].

        A privileged policy also gets the action of the task's planner, if there is one.
        """
        values = {"observation": _plain(self._obs)}
        if self._planner is None or self._planner.command is None:
            return values
        return {**values, "expert": self._expert(self._planner.command)}

    def simulated(self) -> Simulated:
        """Return ManiSkill's own observation, and the last commands of its controllers, one arm after the other."""
        return Simulated(_plain(self._obs), self._last_command)

    def close(self) -> None:
        """Release the simulator."""
        if self._planner is not None:
            self._planner.end()
        self._env.close()

    def _make_env(self, make: Any, mode: str) -> Any:
        try:
            return make(
                f"{self.setup.task}-v1",
                obs_mode="state_dict",
                reward_mode="sparse",
                control_mode=mode,
                sim_backend="physx_cpu",
                render_backend="cpu",
                sensor_configs=self._renderer.options(),
            ).unwrapped
        except RuntimeError as error:
            if any(word in str(error) for word in VULKAN_COMPLAINTS):
                raise no_vulkan("ManiSkill", error) from error
            raise

    def _as_agents(self, commands: list[Any]) -> Any:
        if len(self._arms) == 1:
            return commands[0]
        return dict(zip(self._env.agent.agents_dict, commands, strict=True))

    def _expert(self, command: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Return what the planner does now, as an action step of the standard; planners move one arm."""
        arm, dof = self._arms[0], self.setup.embodiment.arms[0].dof
        angles, rest = command[:dof], command[dof:]
        action = {spec.State.EE_JOINT_STATE: np.array([arm.gripper.opening_for(rest)])}
        if self.setup.action_type == spec.ACTION_TYPES[0]:
            return {**action, spec.State.ARM_JOINT_STATE: angles}
        return {**action, spec.State.EE_POSE: compose(arm.base, self._chain().flange(angles))}

    def _chain(self) -> Chain:
        return Chain.from_embodiment(self.setup.embodiment.data)


def _of(arm: Arm, action: Mapping[str, Any]) -> dict[str, Any]:
    """Return an arm's part of an action step."""
    return {name: value for name, value in action.items() if name.startswith(arm.prefix)}


def _plain(seen: Any) -> Any:
    """Return maps of ManiSkill's batches of one as maps of arrays."""
    if isinstance(seen, Mapping):
        return {name: _plain(value) for name, value in seen.items()}
    return np.asarray(seen)[0]


def _require_assets(setup: Setup) -> None:
    """Check that the assets of a task are there: ManiSkill would ask at the terminal whether to download them.

    Raises:
        NotInstalledError: they are not.
    """
    names = setup.facts.get("assets", ())
    if not names:
        return
    from mani_skill.utils.assets import data

    assets = [each for name in names for each in data.DATA_GROUPS.get(name, [name])]
    missing = [name for name in assets if not data.is_data_source_downloaded(name)]
    if missing:
        raise NotInstalledError(
            f"{setup.task} needs assets that are not in ManiSkill's package: `python -m "
            f"mani_skill.utils.download_asset {' '.join(names)}`, in the Python of envs/maniskill, downloads them"
        )
