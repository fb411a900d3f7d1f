"""A mock of RoboDojo's TASK_ENV: operations of its loops, their results, and how episodes end.

Source: RoboDojo-Benchmark/RoboDojo, src/eval_client/eval_env.py at 36bfcb7. There is no simulator behind it. Layouts
with an odd number end by script before the step limit, where RoboDojo's would by success, so that lists shrink;
nothing here is a success.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.embodiment import get_embodiment
from xpl.environment import one_of
from xpl.manifest import EnvManifest

from . import actions
from .scene import Scene

BY_SCRIPT, BY_LIMIT = "scripted_end", "max_steps"
_OPTIONS = ("task", "max_steps", "cameras", "setting")
_KEYS = (*_OPTIONS, "embodiment", spec.Deploy.ACTION_TYPE, "num_envs", spec.Deploy.SEED, spec.Obs.PRIVILEGED)
_MATRICES = "matrices"


class RoboDojoEnv:
    """Some environments that are driven as RoboDojo's are.

    Args:
        manifest: env.yml as a map.
        config: task, embodiment (arx_x5), num_envs (1), max_steps (the task's), cameras (true, false or [height,
            width]), setting (the first). `action_type` is checked and nothing else: RoboDojo tells it by the keys.

    Attributes:
        num_envs: how many there are.
        eval_batch: whether loops for several environments are played.
        step_lim: control steps after which an episode ends.
        end_flag: of each environment, whether its episode has ended.
        take_action_cnt: of each environment, control steps so far.
        frames: of each environment, pictures that RoboDojo would have put into its film.
        model_client: the policy, where `reset` is to reset it, too.

    Raises:
        ValueError: a value is missing, unknown or not offered.
    """

    guarded = True  # nothing moves here

    def __init__(self, manifest: EnvManifest, config: Mapping[str, Any]) -> None:
        for key in config:
            one_of("configuration key", key, _KEYS)
        self._manifest, self._config = manifest, {"task": next(iter(manifest.tasks)), **config}
        one_of("embodiment", self._config.get("embodiment"), manifest.embodiments)
        one_of(spec.Deploy.ACTION_TYPE, config.get(spec.Deploy.ACTION_TYPE, actions.JOINT), manifest.action_types)
        self._robot = get_embodiment(self._config["embodiment"])
        self.num_envs = int(config.get("num_envs") or 1)
        if self.num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {self.num_envs}")
        self.eval_batch = self.num_envs > 1
        self.model_client: Any = None
        self._next = int(config.get(spec.Deploy.SEED) or 0)
        self._choose({})
        self._scenes: list[Scene] = []

    def reset(self, seed: Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Begin an episode in every environment, and reset the policy; loops reset it once more.

        Args:
            seed: numbers of layouts; an environment without one, or with None, has no episode. None counts on.
            options: new values for task, max_steps, cameras or setting.

        Raises:
            ValueError: there are more layouts than environments, none at all, or an unknown option or value.
        """
        self._choose(options or {})
        layouts = list(range(self._next, self._next + self.num_envs)) if seed is None else list(seed)
        if len(layouts) > self.num_envs or all(layout is None for layout in layouts):
            raise ValueError(f"reset takes up to {self.num_envs} layouts, and at least one, got {layouts}")
        layouts += [None] * (self.num_envs - len(layouts))
        self._layouts = [None if layout is None else int(layout) for layout in layouts]
        if min(layout for layout in self._layouts if layout is not None) < 0:
            raise ValueError(f"layouts are numbers from 0, got {layouts}")
        self._next = 1 + max(layout for layout in self._layouts if layout is not None)
        matrices = self._setting == _MATRICES
        self._scenes = [Scene(self._robot, layout or 0, self._size, matrices=matrices) for layout in self._layouts]
        self.end_flag = [layout is None for layout in self._layouts]
        self._reasons: list[str | None] = [None] * self.num_envs
        self.take_action_cnt = [0] * self.num_envs
        self.frames = [0] * self.num_envs
        if self.model_client is not None:
            self.model_client.call(func_name=spec.Method.RESET)

    def get_obs(self) -> dict[str, Any]:
        """Return the observation of environment 0."""
        return self.get_obs_batch(env_idx_list=[0])[0]

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - RoboDojo's own signature
    ) -> list[dict[str, Any]]:
        """Return observations of some environments, of all by default, also of those that have ended.

        Args:
            env_idx_list: which; each observation has its `env_idx` and shares no array with others.
            last_frame: whether the image of an environment that has ended still belongs to its video.
        """
        observations = []
        for index in self._indices(env_idx_list):
            if not self.end_flag[index] or last_frame:
                self.frames[index] += 1
            obs = deepcopy(self._scenes[index].observe(self._instruction, self._frequency))
            obs[spec.Obs.ENV_IDX] = index
            observations.append(obs)
        return observations

    def take_action(self, action: Mapping[str, Any]) -> None:
        """Execute one action step in environment 0.

        Raises:
            ActionError: RoboDojo refuses it.
        """
        self.take_action_batch([action], env_idx_list=[0])

    def take_action_batch(
        self, actions_list: Sequence[Mapping[str, Any]], env_idx_list: Sequence[int] | None = None
    ) -> None:
        """Execute one action in each of some environments, of all by default, and update which have ended.

        Raises:
            ActionError: RoboDojo refuses an action; or one is missing, or is for an environment that has ended while
                another one of the list runs. RoboDojo raises IndexError and AssertionError for these.
        """
        indices = self._indices(env_idx_list)
        if len(actions_list) < len(indices):
            raise ActionError(f"there are {len(actions_list)} actions for {len(indices)} environments, {indices}")
        moves = {}
        for index, action in zip(indices, actions_list):  # noqa: B905 - RoboDojo takes more actions than environments
            actions.validate(action, self._robot)
            controls = actions.controls(action, self._robot)
            if not self.end_flag[index]:
                moves[index] = controls
        if moves and len(moves) < len(indices):
            ended = [index for index in indices if index not in moves]
            raise ActionError(
                f"environments {ended} have ended and {list(moves)} have not: RoboDojo takes actions for those that "
                "run only, so call get_running_env_idx_list() before each step"
            )
        for index, controls in moves.items():
            self.take_action_cnt[index] += 1
            self._scenes[index].move(controls)
        self.is_episode_end()

    def is_episode_end(self) -> bool:
        """Update which environments have ended, and return whether all have."""
        changed = []
        for index, scene_layout in enumerate(self._layouts):
            if self.end_flag[index] or scene_layout is None:
                continue
            count = self.take_action_cnt[index]
            if count >= self._scripted_end(scene_layout):
                self._reasons[index] = BY_SCRIPT
            elif count >= self.step_lim:
                self._reasons[index] = BY_LIMIT
            else:
                continue
            self.end_flag[index] = True
            changed.append(index)
        if changed:
            self.get_obs_batch(env_idx_list=changed, last_frame=True)
        return all(self.end_flag)

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of the environments whose episode goes on."""
        self._start_episode()
        return [index for index in range(self.num_envs) if not self.end_flag[index]]

    def results(self) -> list[dict[str, Any]]:
        """Return one result per environment; there is nothing to succeed at, and no number of RoboDojo's."""
        self._start_episode()
        return [
            {
                spec.Obs.ENV_IDX: index,
                "task": self._config["task"],
                spec.Deploy.SEED: layout,
                spec.Obs.INSTRUCTION: self._instruction,
                "success": None,
                "score": None,
                "steps": self.take_action_cnt[index],
                "end_reason": self._reasons[index],
            }
            for index, layout in enumerate(self._layouts)
        ]

    def close(self) -> None:
        """Forget everything."""
        self._scenes = []

    def _scripted_end(self, layout: int) -> float:
        """Return after how many steps a layout ends before the limit; never for an even one."""
        return max(1, self.step_lim * (2 + layout % 5) // 8) if layout % 2 else float("inf")

    def _choose(self, options: Mapping[str, Any]) -> None:
        for key in options:
            one_of("reset option", key, _OPTIONS)
        config = {**self._config, **options}
        one_of("task", config["task"], self._manifest.tasks)
        task, settings = self._manifest.tasks[config["task"]], self._manifest.settings
        self._setting = config.get("setting") or settings[0]
        one_of("setting", self._setting, settings)
        self.step_lim = int(config.get("max_steps") or task.max_steps)
        if self.step_lim < 1:
            raise ValueError(f"max_steps must be at least 1, got {self.step_lim}")
        self._instruction: str = task.instruction
        self._frequency = self._manifest.control_frequency
        self._size = _size(config.get("cameras", True), self._manifest.cameras)
        self._config = config

    def _indices(self, requested: Sequence[int] | None) -> list[int]:
        self._start_episode()
        chosen = list(range(self.num_envs)) if requested is None else list(requested)
        unknown = [index for index in chosen if not 0 <= index < self.num_envs]
        if unknown:
            raise ValueError(f"there is no environment {unknown[0]}; indices go from 0 to {self.num_envs - 1}")
        return chosen

    def _start_episode(self) -> None:
        if not self._scenes:
            raise RuntimeError("no episode has begun: call reset first")


def _size(cameras: Any, offered: Mapping[str, Any]) -> tuple[int, int] | None:
    if isinstance(cameras, bool):
        first = next(iter(offered.values()))
        return (first["height"], first["width"]) if cameras else None
    if len(cameras) != 2 or min(cameras) < 1:
        raise ValueError(f"cameras must be true, false or [height, width] in pixels, got {cameras!r}")
    return int(cameras[0]), int(cameras[1])
