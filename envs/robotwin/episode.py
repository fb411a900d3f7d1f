"""One task of RoboTwin as an episode: `xpl eval` runs it seed by seed, with the standard's loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xpl import _spec as spec
from xpl.environment import Episode, Setup
from xpl.episode import SUCCESS_SCORE, Simulated

from . import convert
from .loop import SEEN, Source, ask_expert
from .upstream import UpstreamSource, quiet
from .without_gpu import SourceWithoutGpu

UNREACHED = "unreached"
_NEAR = 0.01  # m; farther from its target, an arm has found no path, which RoboTwin does not report


class RoboTwinEpisode(Episode):
    """An episode of RoboTwin.

    Args:
        setup: task, setting and robot.
        source: of the task; by default RoboTwin's own code, in a setting of `stand_ins` with a mock robot.

    Raises:
        NotInstalledError: its code or its assets are missing.
        ValueError: the setting does not have what the task needs.
    """

    def __init__(self, setup: Setup, source: Source | None = None) -> None:
        super().__init__(setup)
        stand_in = setup.manifest.data["stand_ins"].get(setup.setting)
        if stand_in is not None and setup.task not in stand_in["tasks"]:
            raise ValueError(
                f"{setup.task} needs objects that only RoboTwin's assets have; {setup.setting} plays "
                f"{', '.join(stand_in['tasks'])}"
            )
        self._source = source or (UpstreamSource() if stand_in is None else SourceWithoutGpu())
        self._task = self._source.make(setup.task)
        theirs = setup.setting if stand_in is None else stand_in["plays"]
        arguments = self._source.arguments(setup.task, theirs)
        self._arguments = {**arguments, "eval_mode": True, "render_freq": 0, "eval_video_save_dir": None}
        self._played: int | None = None

    def reset(self, seed: int) -> None:
        """Begin an episode, if RoboTwin's expert solves the seed; with the mock robot it need not.

        Raises:
            RuntimeError: it does not, or objects do not come to rest: RoboTwin does not count such a seed.
        """
        with quiet():
            self._leave()
            info = self._set_up(seed)
            wordings = self._source.describe(self.setup.task, info, 1, seed).get(SEEN)
        task = self._task
        task.set_instruction(instruction=wordings[seed % len(wordings)] if wordings else self.setup.task)
        task.step_lim = self.setup.max_steps  # at which RoboTwin stops listening
        self._last_command: NDArray[np.float32] | None = None
        self._seen: dict[str, Any] | None = None

    @property
    def instruction(self) -> str:
        """RoboTwin's wording for this seed."""
        return str(self._task.get_instruction())

    def state(self) -> dict[str, NDArray[np.float32]]:
        """Return the robot's state."""
        robot = self._task.robot
        return convert.state(convert.of_robot(robot), robot)

    def step(self, action: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Execute one action step, which takes as long as its motion does."""
        self._last_command, kind = convert.command(action, self.setup.embodiment, self.setup.action_type)
        with quiet():
            self._task.take_action(self._last_command, action_type=kind)
        self._seen = None
        return {} if kind != convert.ACTION_TYPES["ee"] or self._task.eval_success else self._missed_targets(action)

    def score(self) -> float:
        """Return 1 for RoboTwin's success, else 0."""
        return SUCCESS_SCORE if self._task.eval_success else 0.0

    def vision(self) -> dict[str, dict[str, Any]]:
        """Return what RoboTwin's cameras see."""
        return convert.vision(self._observe(), self.setup.manifest.cameras)

    def simulated(self) -> Simulated:
        """Return RoboTwin's own observation, and its last flat command."""
        return Simulated(self._observe(), self._last_command)

    def close(self) -> None:
        """Close RoboTwin's scene."""
        self._leave()

    def _set_up(self, seed: int) -> Mapping[str, Any]:
        """Set a seed up, and return the names of objects in RoboTwin's expert."""
        task = self._task
        self._played = (self._played or 0) + 1
        try:
            task.setup_demo(now_ep_num=0, seed=seed, is_test=True, **self._arguments)
            info, is_solved = ask_expert(self._source, task)
            if not is_solved:
                raise RuntimeError(f"RoboTwin's expert does not solve seed {seed}: it is none to evaluate with")
            if self._source.has_expert:
                task.close_env()
                task.setup_demo(now_ep_num=0, seed=seed, is_test=True, **self._arguments)
        except self._source.unstable as error:
            raise RuntimeError(f"seed {seed} is unstable, and none to evaluate with: {error}") from None
        return info

    def _leave(self) -> None:
        """Close the scene of the episode before; SAPIEN's caches are cleared as often as in RoboTwin's own loop."""
        if self._played is not None:
            every = int(self._arguments.get("clear_cache_freq") or 0)
            self._task.close_env(clear_cache=bool(every) and self._played % every == 0)

    def _observe(self) -> dict[str, Any]:
        """Return RoboTwin's observation, whose cameras are rendered at most once per step, on demand."""
        if self._seen is None:
            with quiet():
                self._seen = self._task.get_obs()
        return self._seen

    def _missed_targets(self, action: Mapping[str, Any]) -> dict[str, dict[str, float]]:
        """Return how far each arm is from where it was sent, m, where that is far."""
        state, found = self.state(), {}
        for side in convert.SIDES:
            name = f"{side}_{spec.State.EE_POSE}"
            missed = float(np.linalg.norm((np.asarray(action[name]) - state[name])[: spec.POSITION_DIM]))
            if missed > _NEAR:
                found[f"{side}_"] = {UNREACHED: missed}
        return found
