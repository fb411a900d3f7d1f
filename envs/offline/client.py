"""The offline environment: scripted observations, perfect execution, the surface that benchmarks use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from xpl import _spec as spec
from xpl.action import check_step
from xpl.embodiment import get_embodiment

from .scenario import SIZE, advance, observation

DEFAULT_STEPS = 5


class OfflineEnv:
    """Some environments that take every valid action and end after a fixed number of steps.

    Args:
        config: `embodiment`, `action_type`, `num_envs`, `max_steps`, `cameras` ([height, width] of images).
    """

    guarded = True  # nothing moves here

    def __init__(self, config: Mapping[str, Any]) -> None:
        self.embodiment = get_embodiment(config["embodiment"])
        self._action_type: str = config[spec.Deploy.ACTION_TYPE]
        self.embodiment.dims(self._action_type)  # refuses what is no action type
        cameras = config.get("cameras")
        self._size = SIZE if cameras is None or isinstance(cameras, bool) else tuple(cameras)
        self._max_steps: int = config.get("max_steps") or DEFAULT_STEPS
        self._seeds: list[int] = list(range(config.get("num_envs") or 1))
        self.reset()

    def reset(self, seed: Sequence[int] | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Start an episode in every environment; the seed changes nothing here but is recorded."""
        if seed is not None:
            self._seeds = list(seed)
        self._steps = 0
        self._obs = {env: observation(self.embodiment, env, size=self._size) for env in range(len(self._seeds))}

    def get_obs(self) -> dict[str, Any]:
        """Return the observation of environment 0."""
        return self._obs[0]

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks pass it by position
    ) -> list[dict[str, Any]]:
        """Return the observations of these environments, of all running ones by default."""
        return [self._obs[env] for env in (self.get_running_env_idx_list() if env_idx_list is None else env_idx_list)]

    def take_action(self, action: Mapping[str, Any]) -> None:
        """Execute one action step in environment 0.

        Raises:
            ActionError: if the step is not one of the embodiment and action type.
        """
        self.take_action_batch([action], [0])

    def take_action_batch(self, actions: Sequence[Mapping[str, Any]], env_idx_list: Sequence[int]) -> None:
        """Execute one action step in each of these environments; nothing happens when the episodes have ended."""
        if len(actions) != len(env_idx_list):
            raise ValueError(f"expected one action per environment: {len(env_idx_list)}, got {len(actions)}")
        unknown = [env for env in env_idx_list if env not in self._obs]
        if unknown:
            raise ValueError(f"there is no environment {unknown[0]}; indices go from 0 to {len(self._obs) - 1}")
        for action in actions:
            check_step(action, self.embodiment, self._action_type)
        if self.is_episode_end():
            return
        self._steps += 1
        for env, action in zip(env_idx_list, actions, strict=True):
            self._obs[env] = advance(self._obs[env], action, self._steps)

    def is_episode_end(self) -> bool:
        """Return whether every environment has ended."""
        return self._steps >= self._max_steps

    def get_running_env_idx_list(self) -> list[int]:
        """Return the environments that still run."""
        return [] if self.is_episode_end() else sorted(self._obs)

    def finish_episode(self) -> None:
        """Nothing is to be done at the end of an episode here."""

    def results(self) -> list[dict[str, Any]]:
        """Return one result per environment; there is no task to succeed at."""
        return [
            {
                spec.Obs.ENV_IDX: env,
                spec.Deploy.SEED: seed,
                "success": None,
                "score": None,
                "steps": self._steps,
                "end_reason": "max_steps",
            }
            for env, seed in enumerate(self._seeds)
        ]

    def close(self) -> None:
        """Nothing to release."""


def make(config: Mapping[str, Any]) -> OfflineEnv:
    """Return the environment for a configuration."""
    return OfflineEnv(config)
