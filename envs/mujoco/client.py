"""The environment client: `make(config)` gives the TASK_ENV that benchmarks and the audit drive.

Importing this module is cheap; MuJoCo comes in with the first `make`.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.embodiment import get_embodiment

from .manifest import manifest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .episode import Episode

NATIVE = "native"
_RESET_OPTIONS = ("task", spec.Obs.PRIVILEGED, "max_steps", "cameras", "setting")


@dataclass(frozen=True)
class Config:
    """What an environment is made with.

    Attributes:
        task: a task of env.yml.
        embodiment: an embodiment of env.yml, or an alias.
        action_type: "joint" or "ee".
        num_envs: environments stepped in this process.
        max_steps: control steps of an episode; None for the task's own.
        cameras: True for the manifest's resolution, False for none, or (height, width) for all.
        privileged: whether observations show the simulator's truth.
        seed: of the first environment where `reset` is given none; the others count on from it.
        setting: a setting of env.yml.
        renderer: "raycast", which needs no graphics library, or "egl" or "osmesa", for looks.
    """

    task: str
    embodiment: str
    action_type: str = spec.ACTION_TYPES[0]
    num_envs: int = 1
    max_steps: int | None = None
    cameras: bool | Sequence[int] = True
    privileged: bool = False
    seed: int = 0
    setting: str = "clean"
    renderer: str = "raycast"

    def __post_init__(self) -> None:
        """Check names and ranges.

        Raises:
            ValueError: a value is not one this environment offers.
        """
        facts = manifest()
        robot = get_embodiment(self.embodiment)
        _one_of("task", self.task, facts["tasks"])
        _one_of("embodiment", robot.name, facts["ready"])
        _one_of(spec.Deploy.ACTION_TYPE, self.action_type, facts["action_types"])
        _one_of("setting", self.setting, facts["settings"])
        _one_of("renderer", self.renderer, facts["renderers"])
        arms = facts["tasks"][self.task]["arms"]
        if len(robot.arms) not in arms:
            raise ValueError(f"task {self.task} is for {arms} arms; {robot.name} has {len(robot.arms)}")
        reason = facts["tasks"][self.task].get("unsupported", {}).get(robot.name)
        if reason is not None:
            raise ValueError(f"task {self.task} is not offered with {robot.name}: {reason}")
        if self.num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {self.num_envs}")
        if self.max_steps is not None and self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1 or None, got {self.max_steps}")
        if not isinstance(self.cameras, bool) and (len(self.cameras) != 2 or min(self.cameras) < 1):
            raise ValueError(f"cameras must be true, false or [height, width] in pixels, got {self.cameras!r}")


class MujocoEnv:
    """One or several environments in one process, with the surface that benchmarks call TASK_ENV.

    `reset` comes first. An environment whose episode has ended leaves the running list; an action for it is ignored.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._next_seed = config.seed
        self._episodes: list[Episode] = []
        self._last: dict[int, dict[str, Any]] = {}

    @property
    def episodes(self) -> tuple[Episode, ...]:
        """The episodes of all environments, for tools that look behind the observations; empty before `reset`."""
        return tuple(self._episodes)

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start a new episode in every environment.

        Args:
            seed: one seed per environment; None counts on from the seeds used before.
            options: new values for task, privileged, max_steps, cameras or setting, from now on.

        Raises:
            ValueError: wrong number of seeds, or an unknown option or value.
            RendererMissingError: this machine lacks what the renderer needs.
        """
        config = replace(self._config, **_known(options or {}, _RESET_OPTIONS, "reset option"))
        seeds = range(self._next_seed, self._next_seed + config.num_envs) if seed is None else [int(s) for s in seed]
        if len(seeds) != config.num_envs or min(seeds) < 0:
            raise ValueError(f"reset needs {config.num_envs} seeds (>= 0), one per environment, got {list(seeds)}")
        from .episode import Episode

        self.close()
        self._config = config
        setup = _setup(config)
        self._episodes = [Episode(setup, number, index) for index, number in enumerate(seeds)]
        self._last = {}
        self._next_seed = seeds[-1] + 1

    def get_obs(self) -> dict[str, Any]:
        """Return the observation of the only environment.

        Raises:
            ValueError: there are several; use `get_obs_batch`.
        """
        return self.get_obs_batch([self._single()])[0]

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[dict[str, Any]]:
        """Return the observations of some environments, in the order asked for.

        Args:
            env_idx_list: which; None for all that are running.
            last_frame: return each environment's last observation again, where there is one, and render nothing.
        """
        chosen = self.get_running_env_idx_list() if env_idx_list is None else list(env_idx_list)
        for index in chosen:
            if not (last_frame and index in self._last):
                self._last[index] = self._episode(index).observe()
        return [self._last[index] for index in chosen]

    def take_action(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Execute one action step in the only environment; return its report (see `take_action_batch`)."""
        return self._episode(self._single()).step(action)

    def take_action_batch(
        self, actions: Sequence[Mapping[str, Any]], env_idx_list: Sequence[int]
    ) -> list[dict[str, Any]]:
        """Execute one action step in each of some environments.

        Returns:
            one report per action: ``env_idx``, ``step`` (steps executed so far), ``end_reason`` (None while running)
            and ``corrections``: per arm prefix what had to be changed, with the amount (see `control.Correction`).

        Raises:
            ActionError: an action has the wrong keys or dimensions; environments before it in the list have moved.
            ValueError: the lists differ in length, or an index is repeated or unknown.
        """
        if len(actions) != len(env_idx_list) or len(set(env_idx_list)) != len(env_idx_list):
            raise ValueError(
                f"take_action_batch needs one action for each environment once, "
                f"got {len(actions)} actions for {list(env_idx_list)}"
            )
        episodes = [self._episode(index) for index in env_idx_list]
        return [episode.step(action) for episode, action in zip(episodes, actions, strict=True)]

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of the environments whose episode goes on."""
        self._started()
        return [index for index, episode in enumerate(self._episodes) if episode.end_reason is None]

    def results(self) -> list[dict[str, Any]]:
        """Return the outcome of every environment's episode so far (see `Episode.result`)."""
        self._started()
        return [episode.result() for episode in self._episodes]

    def render(self, env_idx: int = 0, camera: str = spec.OPTIONAL_CAMERAS[0]) -> NDArray[np.uint8]:
        """Return what a camera of env.yml sees now, (H, W, 3) uint8 RGB, for people; observations do not change."""
        entries = manifest()["cameras"]
        _one_of("camera", camera, entries)
        frame = self._episode(env_idx).render(camera, entries[camera]["height"], entries[camera]["width"])
        return frame.color

    def close(self) -> None:
        """Drop all episodes."""
        for episode in self._episodes:
            episode.close()
        self._episodes = []
        self._last = {}

    def _single(self) -> int:
        if self._config.num_envs != 1:
            raise ValueError(f"there are {self._config.num_envs} environments; use get_obs_batch and take_action_batch")
        return 0

    def _episode(self, index: int) -> Episode:
        self._started()
        if not 0 <= index < len(self._episodes):
            raise ValueError(f"there is no environment {index}; indices go from 0 to {len(self._episodes) - 1}")
        return self._episodes[index]

    def _started(self) -> None:
        if not self._episodes:
            raise RuntimeError("no episode has begun: call reset first")


def make(config: Mapping[str, Any]) -> MujocoEnv:
    """Make the environment.

    Args:
        config: values of `Config`; task and embodiment are required.

    Raises:
        ValueError: a value is missing, unknown or not offered.
    """
    known = _known(config, tuple(Config.__dataclass_fields__), "configuration key")
    missing = [name for name in ("task", "embodiment") if not known.get(name)]
    if missing:
        raise ValueError(f"the configuration lacks {' and '.join(missing)}; tasks are {', '.join(manifest()['tasks'])}")
    return MujocoEnv(Config(**known))


def _setup(config: Config) -> Any:
    from .episode import Setup

    size: tuple[int, int] | str | None
    if isinstance(config.cameras, bool):
        size = NATIVE if config.cameras else None
    else:
        size = (int(config.cameras[0]), int(config.cameras[1]))
    return Setup(
        task=config.task,
        embodiment=get_embodiment(config.embodiment),
        action_type=config.action_type,
        max_steps=config.max_steps or manifest()["tasks"][config.task]["max_steps"],
        camera_size=size,
        privileged=config.privileged,
        setting=config.setting,
        renderer=config.renderer,
    )


def _known(values: Mapping[str, Any], names: Sequence[str], what: str) -> dict[str, Any]:
    for key in values:
        _one_of(what, key, names)
    return dict(values)


def _one_of(what: str, value: Any, offered: Any) -> None:
    if value not in offered:
        near = difflib.get_close_matches(str(value), [str(name) for name in offered], n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown {what} {value!r}: this environment offers {', '.join(map(str, offered))}{hint}")
