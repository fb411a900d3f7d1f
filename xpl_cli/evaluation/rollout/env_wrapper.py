"""A task environment before another one, which sees or changes what passes between that and an evaluation loop."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from xpl.contract import Action, ObservationDict
    from xpl.environment import TaskEnv

_INFERENCE_OPERATIONS = (sdk.Method.GET_ACTION, sdk.Method.GET_ACTION_BATCH, sdk.Method.INFER)


class TaskEnvWrapper:
    """A task environment that forwards everything; subclasses override single hooks.

    Args:
        task_env: the environment.
    """

    def __init__(self, task_env: TaskEnv) -> None:
        self._env = task_env

    def __getattr__(self, name: str) -> Any:
        """Return what the environment offers besides the surface."""
        return getattr(self._env, name)

    def get_obs(self) -> ObservationDict:
        """Return the observation of the environment."""
        return self._on_observation(0, self._env.get_obs())

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments, of all running ones by default."""
        indices = list(self._env.get_running_env_idx_list() if env_idx_list is None else env_idx_list)
        observations = self._env.get_obs_batch(env_idx_list, last_frame)
        return [self._on_observation(env, obs) for env, obs in zip(indices, observations, strict=False)]

    def take_action(self, action: Action) -> Any:
        """Execute an action step."""
        self._before_step([action], [0])
        report = self._env.take_action(action)
        self._after_step([action])
        return report

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> Any:
        """Execute an action step of each environment in the list."""
        self._before_step(actions, env_idx_list)
        reports = self._env.take_action_batch(actions, env_idx_list)
        self._after_step(actions)
        return reports

    def listen(self, client: Any) -> Any:
        """Return the client with timed inference calls, also for wrappers further inside."""
        inner = getattr(self._env, "listen", None)
        return TimedClient(client if inner is None else inner(client), self._on_inference)

    def _on_observation(self, _env: int, obs: ObservationDict) -> ObservationDict:
        """Return an observation of an environment as the loop gets it."""
        return obs

    def _before_step(self, actions: Sequence[Action], envs: Sequence[int]) -> None:
        """See, or refuse, the actions that environments are about to execute."""

    def _after_step(self, actions: Sequence[Action]) -> None:
        """See the actions that were executed."""

    def _on_inference(self, seconds: float) -> None:
        """Handle the duration of an inference."""


class TimedClient:
    """A client whose answers with actions are timed; everything else passes."""

    def __init__(self, client: Any, on_inference: Callable[[float], None]) -> None:
        self._client = client
        self._asked = on_inference

    def __getattr__(self, name: str) -> Any:
        attribute = getattr(self._client, name)
        return self._timed(attribute) if name in _INFERENCE_OPERATIONS else attribute

    def call(self, func_name: str, *args: Any, **kwargs: Any) -> Any:
        """Call an operation by name."""
        call = self._timed(self._client.call) if func_name in _INFERENCE_OPERATIONS else self._client.call
        return call(func_name, *args, **kwargs)

    def _timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def ask(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            answer = function(*args, **kwargs)
            self._asked(time.perf_counter() - began)
            return answer

        return ask
