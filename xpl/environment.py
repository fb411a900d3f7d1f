"""Environments: the interface of evaluation loops, and its implementation for an author's `Episode`.

Benchmarks call an environment TASK_ENV. `Environment` implements that interface for any number of environments in one
process; the author writes `Episode` (`xpl.episode`), the simulator of one environment, and `env.yml`.
"""

from __future__ import annotations

import importlib.util
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from xpl import _spec as spec
from xpl.configuration import EnvConfiguration, one_of
from xpl.episode import Episode, EpisodeRunner, Setup, Simulated
from xpl.manifest import EnvManifest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from xpl.contract import Action, Config, ObservationDict, Report, Result

__all__ = [
    "Environment",
    "EnvironmentBase",
    "Episode",
    "NotInstalledError",
    "Setup",
    "TaskEnv",
    "one_of",
    "read_manifest",
    "require",
]


class NotInstalledError(RuntimeError):
    """The simulator is not installed in the environment's Python; the message says how to install it."""


class TaskEnv(Protocol):
    """Interface of environments for evaluation loops; `make(config)` of an environment's client file returns one."""

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start a new episode in every environment, one seed each."""

    def get_obs(self) -> ObservationDict:
        """Return the observation of the only environment."""

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments, of all running ones by default."""

    def take_action(self, action: Action) -> Any:
        """Execute one action step in the only environment."""

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> Any:
        """Execute one action step in each of some environments."""

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of the environments whose episode goes on."""

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode."""

    def close(self) -> None:
        """Release everything."""


class SingleEnv(Protocol):
    """One environment of several: runs its episodes, as `EpisodeRunner` does for an author's `Episode`."""

    @property
    def end_reason(self) -> str | None:
        """Why the episode has ended; None while it goes on."""

    def reset(self, seed: int) -> None:
        """Begin an episode."""

    def observe(self) -> ObservationDict:
        """Return the present observation."""

    def step(self, action: Action) -> Report:
        """Execute one action step and return its report; an episode that has ended ignores it."""

    def result(self) -> Result:
        """Return the episode's outcome so far."""

    def close(self) -> None:
        """Release its resources."""


SingleEnvT = TypeVar("SingleEnvT", bound=SingleEnv)


class EnvironmentBase(ABC, Generic[SingleEnvT]):
    """One or several environments in one process, with the interface that benchmarks call TASK_ENV.

    Call `reset` first. An environment whose episode has ended leaves the running list; actions for it are ignored.

    Args:
        manifest: env.yml (`read_manifest`).
        config: task, embodiment, action_type, num_envs (1), max_steps (the task's), cameras (true, false or
            [height, width]), privileged (false), seed (0, of the first environment if `reset` gets none),
            setting (the first of env.yml).

    Raises:
        ValueError: a value is missing, unknown or not offered.
    """

    guarded = True
    """Whether the robot's limits are enforced; each `SingleEnv` must do so."""

    def __init__(self, manifest: EnvManifest, config: Config) -> None:
        self._manifest = manifest
        self._config = EnvConfiguration.read(config, manifest)
        self._setup = self._config.setup(manifest)
        self._next_seed = self._config.seed
        self._envs: list[SingleEnvT] = []
        self._last: dict[int, ObservationDict] = {}
        self._begun = False

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start a new episode in every environment.

        Args:
            seed: one seed per environment; None counts on from the seeds used before.
            options: new values for task, privileged, max_steps, cameras or setting, from now on.

        Raises:
            ValueError: wrong number of seeds, or an unknown option or value.
        """
        config = self._config.with_options(options or {})
        setup = config.setup(self._manifest)
        count = config.num_envs
        seeds = list(range(self._next_seed, self._next_seed + count)) if seed is None else [int(s) for s in seed]
        if len(seeds) != count or min(seeds) < 0:
            raise ValueError(f"reset needs {count} seeds (>= 0), one per environment, got {seeds}")
        if setup != self._setup:
            self.close()
        self._config, self._setup = config, setup
        if not self._envs:
            self._envs = [self._make_env(setup, index) for index in range(count)]
        self._last = {}
        for env, number in zip(self._envs, seeds):
            env.reset(number)
        self._begun = True
        self._next_seed = seeds[-1] + 1

    def get_obs(self) -> ObservationDict:
        """Return the observation of the only environment.

        Raises:
            ValueError: there are several environments; use `get_obs_batch`.
        """
        index = self._only_index()
        self._last[index] = obs = self._env(index).observe()
        return obs

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments, in the order of the list.

        Args:
            env_idx_list: indices of environments; None for all that are running.
            last_frame: return each environment's last observation again, if there is one, without rendering.
        """
        chosen = self.get_running_env_idx_list() if env_idx_list is None else list(env_idx_list)
        for index in chosen:
            if not (last_frame and index in self._last):
                self._last[index] = self._env(index).observe()
        return [self._last[index] for index in chosen]

    def take_action(self, action: Action) -> Report:
        """Execute one action step in the only environment; return its report (see `take_action_batch`)."""
        return self._env(self._only_index()).step(action)

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> list[Report]:
        """Execute one action step in each of some environments.

        Returns:
            One report per action: ``env_idx``, ``step`` (steps executed so far), ``end_reason`` (None while running)
            and ``corrections`` of the command (see `xpl.episode.Corrections`).

        Raises:
            ActionError: an action has the wrong keys or dimensions; environments before it in the list have moved.
            ValueError: the lists differ in length, or an index is repeated or unknown.
        """
        if len(actions) != len(env_idx_list) or len(set(env_idx_list)) != len(env_idx_list):
            raise ValueError(
                f"take_action_batch needs one action for each environment once, "
                f"got {len(actions)} actions for {list(env_idx_list)}"
            )
        chosen = [self._env(index) for index in env_idx_list]
        return [env.step(action) for env, action in zip(chosen, actions)]

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of the environments whose episode goes on."""
        self._require_started()
        return [index for index, env in enumerate(self._envs) if env.end_reason is None]

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode so far (see `EpisodeRunner.result`)."""
        self._require_started()
        return [env.result() for env in self._envs]

    def close(self) -> None:
        """Release all simulators."""
        for env in self._envs:
            env.close()
        self._envs, self._last, self._begun = [], {}, False

    @abstractmethod
    def _make_env(self, setup: Setup, index: int) -> SingleEnvT:
        """Make one environment.

        Args:
            setup: the checked configuration.
            index: index of the environment, from 0.
        """

    def _only_index(self) -> int:
        if self._config.num_envs != 1:
            raise ValueError(f"there are {self._config.num_envs} environments; use get_obs_batch and take_action_batch")
        return 0

    def _env(self, index: int) -> SingleEnvT:
        self._require_started()
        if not 0 <= index < len(self._envs):
            raise ValueError(f"there is no environment {index}; indices go from 0 to {len(self._envs) - 1}")
        return self._envs[index]

    def _require_started(self) -> None:
        if not self._begun:
            raise RuntimeError("no episode has begun: call reset first")


class Environment(EnvironmentBase[EpisodeRunner]):
    """The environments of an author's `Episode`, with the robot's limits enforced.

    Args:
        episode: makes the simulator of one environment, for example a subclass of `Episode`.
        manifest: env.yml.
        config: see `EnvironmentBase`.

    Raises:
        ValueError: a value is missing, unknown or not offered.
    """

    def __init__(self, episode: Callable[[Setup], Episode], manifest: EnvManifest, config: Config) -> None:
        self._make = episode
        super().__init__(manifest, config)

    def render(self, env_idx: int = 0, camera: str | None = None) -> NDArray[np.uint8]:
        """Return the current image of a camera of env.yml, (H, W, 3) uint8 RGB; the first camera by default.

        Raises:
            ValueError: there is no such camera.
        """
        images = self._env(env_idx).vision()
        name = next(iter(images), None) if camera is None else camera
        one_of("camera", name, images)
        image: NDArray[np.uint8] = images[str(name)][spec.Camera.COLOR]
        return image

    def simulated(self, env_idx: int = 0) -> Simulated | None:
        """Return the simulator's own observation and command, for `xpl.bridge`; None if the episode has none."""
        return self._env(env_idx).simulated()

    def _make_env(self, setup: Setup, index: int) -> EpisodeRunner:
        return EpisodeRunner(self._make(setup), index)


def require(module: str, folder: str | Path) -> None:
    """Check that a benchmark's own code is installed; call it before importing any of it.

    Args:
        module: name of its top-level module.
        folder: the environment package's, or a file in it, such as ``__file__`` of its client.

    Raises:
        NotInstalledError: the module is not installed.
    """
    if importlib.util.find_spec(module) is None:
        path = Path(folder)
        name = (path if path.is_dir() else path.parent).name
        raise NotInstalledError(
            f"{sys.executable} has no {module}, which {name} needs: `xpl install {name}` makes a Python environment "
            "that has it"
        )


def read_manifest(folder: str | Path) -> EnvManifest:
    """Return env.yml of an environment package; needs PyYAML.

    Args:
        folder: the package's folder, or a file in it, such as ``__file__`` of its client.

    Raises:
        RuntimeError: PyYAML is not installed in this Python.
    """
    path = Path(folder)
    try:
        import yaml
    except ImportError:
        raise RuntimeError("reading env.yml takes PyYAML: pip install PyYAML in the environment's Python") from None
    text = ((path if path.is_dir() else path.parent) / "env.yml").read_text(encoding="utf-8")
    # libyaml's loader, if PyYAML has it, takes a tenth of the time.
    return EnvManifest.parse(yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)))  # noqa: S506
