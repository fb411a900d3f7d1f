"""Proxies of environment and client in an evaluation loop: every operation is a message to the evaluator's process.

The evaluator holds the environment, counts steps and decides success; the loop has no access to any of it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.client.errors import ClientError, PolicyServerError
from xpl.loop.shared_arrays import SharedArrays
from xpl.process import link
from xpl.wire import packed

if TYPE_CHECKING:
    from xpl.contract import Action, ObservationDict, Result
    from xpl.process.link import Channel

TASK_ENV, CLIENT = "task_env", "client"
"""Targets of an operation."""
ENV_OPERATIONS = (
    "get_obs",
    "get_obs_batch",
    "take_action",
    "take_action_batch",
    "is_episode_end",
    "get_running_env_idx_list",
    "results",
    "finish_episode",
    "render",
)
CLIENT_OPERATIONS = (
    spec.Message.CALL,
    spec.Method.RESET,
    spec.Method.UPDATE_OBS,
    spec.Method.UPDATE_OBS_BATCH,
    spec.Method.GET_ACTION,
    spec.Method.GET_ACTION_BATCH,
    spec.Method.INFER,
    spec.Message.PREPARE_CASE,
    spec.Message.TRIAL_END,
    spec.Message.HEARTBEAT,
    "health",
    "settle",
)
PIPELINED = (spec.Method.UPDATE_OBS, spec.Method.UPDATE_OBS_BATCH)
"""Operations of the policy that return nothing and are not waited for."""
_KINDS: dict[str, type[Exception]] = {
    kind.__name__: kind for kind in (ActionError, ClientError, ValueError, TypeError, AttributeError)
}
_MAX_CACHED_READS = 16
"""Number of reads of the running environments from the cache before the evaluator is asked again."""


class EvaluatorLink:
    """The link to the evaluator's process, for one thread at a time.

    Args:
        channel: the link.

    Attributes:
        running: environments whose episode goes on, as last reported.
        last_error: the last exception raised here because the environment or the policy failed.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._turn = threading.Lock()
        self._shared_arrays = SharedArrays()
        self._cached_reads = 0
        self.running: list[int] = []
        self.last_error: Exception | None = None

    def begin(self, running: Sequence[int]) -> None:
        """Begin an episode."""
        self.running, self._cached_reads, self.last_error = list(running), 0, None

    def cached_running(self) -> list[int] | None:
        """Return the running environments from the cache, None if the evaluator has to be asked."""
        self._cached_reads += 1
        return list(self.running) if self.running and self._cached_reads <= _MAX_CACHED_READS else None

    def call(self, target: str, operation: str, *arguments: Any, **options: Any) -> Any:
        """Run an operation in the evaluator's process, and return its result; arrays are read-only.

        Updates of the policy are pipelined: nothing waits for an answer, and the next operation raises the error.

        Raises:
            ActionError, ClientError, ValueError, TypeError, AttributeError: as environment or policy raised it.
            PackingError: an argument cannot be encoded.
        """
        is_pipelined = operation in PIPELINED or (
            operation == spec.Message.CALL and options.get(spec.Payload.FUNC_NAME) in PIPELINED
        )
        with self._turn:
            encoded = packed.encode([list(arguments), options], self._shared_arrays.reference_to)
            head = {"target": target, "operation": operation, "pipelined": is_pipelined}
            self._channel.send(head, [b"".join(encoded)])
            if is_pipelined:
                return None
            message = self._channel.receive()
            if message is None:
                os._exit(0)  # the evaluator is gone
            head, buffers = link.decode(message)
            self.running, self._cached_reads = head["running"], 0
            answer = packed.decode(buffers[0])
            if head["ok"]:
                if target == TASK_ENV:
                    self._shared_arrays.add(answer)
                return answer
        self.last_error = _exception_from_answer(answer)
        raise self.last_error


class TaskEnvProxy:
    """Proxy of the environment: what benchmarks call TASK_ENV, already reset.

    Args:
        evaluator: link to the process that holds it.
    """

    guarded = True
    """The evaluator enforces the robot's limits."""

    def __init__(self, evaluator: EvaluatorLink) -> None:
        self._evaluator = evaluator

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"an evaluation loop may not use TASK_ENV.{name}: it may use {', '.join(ENV_OPERATIONS)}")

    def get_obs(self) -> ObservationDict:
        """Return the observation of the only environment."""
        obs: ObservationDict = self._evaluator.call(TASK_ENV, "get_obs")
        return obs

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments.

        Args:
            env_idx_list: their indices; all running environments by default.
            last_frame: passed to the environment as it is.

        Returns:
            One observation for each index, in this order.
        """
        indices = None if env_idx_list is None else list(env_idx_list)
        observations: list[ObservationDict] = self._evaluator.call(TASK_ENV, "get_obs_batch", indices, last_frame)
        return observations

    def take_action(self, action: Action) -> Any:
        """Execute one action in the only environment; return its report."""
        return self._evaluator.call(TASK_ENV, "take_action", action)

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> Any:
        """Execute one action in each environment of the list; return their reports."""
        return self._evaluator.call(TASK_ENV, "take_action_batch", list(actions), list(env_idx_list))

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of the environments whose episode goes on."""
        cached = self._evaluator.cached_running()
        if cached is not None:
            return cached
        running: list[int] = self._evaluator.call(TASK_ENV, "get_running_env_idx_list")
        return running

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode so far."""
        outcomes: list[dict[str, Any]] = self._evaluator.call(TASK_ENV, "results")
        return outcomes

    def finish_episode(self) -> None:
        """Notify the environment that the loop has ended, if it has this method."""
        self._evaluator.call(TASK_ENV, "finish_episode")

    def render(self, env_idx: int = 0, camera: str | None = None) -> Any:
        """Return the current image of a camera, (H, W, 3) uint8 RGB, for people."""
        return self._evaluator.call(TASK_ENV, "render", env_idx, camera)


class ClientProxy:
    """Proxy of the policy's client.

    Args:
        evaluator: link to the process that is connected to the policy.
    """

    def __init__(self, evaluator: EvaluatorLink) -> None:
        self._evaluator = evaluator

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in CLIENT_OPERATIONS:
            raise AttributeError(f"the policy's client offers {', '.join(CLIENT_OPERATIONS)}, and no {name}")
        return lambda *arguments, **options: self._evaluator.call(CLIENT, name, *arguments, **options)

    def close(self) -> None:
        """Do nothing: the connection belongs to the evaluator."""


def _exception_from_answer(answer: Mapping[str, Any]) -> Exception:
    """Return the exception that an answer describes."""
    if answer["type"] == PolicyServerError.__name__:
        return PolicyServerError(answer["code"], answer["message"], answer["details"])
    return _KINDS.get(answer["type"], RuntimeError)(answer["message"])
