"""What a loop is given in place of environment and client: every operation is a message to the process that judges.

There the environment is held, steps are counted and success is decided; nothing of that is within a loop's reach.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.client.errors import ClientError, PolicyServerError
from xpl.loop.shown import Shown
from xpl.process import link
from xpl.wire import packed

if TYPE_CHECKING:
    from xpl.contract import Action, ObservationDict, Result
    from xpl.process.link import Channel

TASK_ENV, CLIENT = "task_env", "client"
"""Whom a question is for."""
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
GO_AHEAD = (spec.Method.UPDATE_OBS, spec.Method.UPDATE_OBS_BATCH)
"""Operations of the policy that return nothing."""
_KINDS: dict[str, type[Exception]] = {
    kind.__name__: kind for kind in (ActionError, ClientError, ValueError, TypeError, AttributeError)
}
_KNOWN_FOR = 16
"""How often a loop may ask whether the episode goes on before the environment is asked anew."""


class Judge:
    """The link to the process that judges, for one thread at a time.

    Args:
        channel: the link.

    Attributes:
        running: environments whose episode goes on, as they were told last.
        told: what was raised here last because the environment or the policy refused.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._turn = threading.Lock()
        self._shown = Shown()
        self._asked = 0
        self.running: list[int] = []
        self.told: Exception | None = None

    def begin(self, running: Sequence[int]) -> None:
        """Begin an episode."""
        self.running, self._asked, self.told = list(running), 0, None

    def known(self) -> list[int] | None:
        """Return the environments that run, where that is known without asking."""
        self._asked += 1
        return list(self.running) if self.running and self._asked <= _KNOWN_FOR else None

    def ask(self, whom: str, operation: str, *arguments: Any, **options: Any) -> Any:
        """Have an operation run, and return what it returns; arrays are read-only.

        What the policy is shown goes ahead, and its answer is not waited for: what is wrong with it is raised by the
        next operation.

        Raises:
            ActionError, ClientError, ValueError, TypeError, AttributeError: as environment or policy raised it.
            PackingError: an argument cannot travel.
        """
        goes_ahead = operation in GO_AHEAD or (
            operation == spec.Message.CALL and options.get(spec.Payload.FUNC_NAME) in GO_AHEAD
        )
        with self._turn:
            given = packed.encode([list(arguments), options], self._shown.place)
            head = {"ask": whom, "operation": operation, "ahead": goes_ahead}
            self._channel.send(head, [b"".join(given)])
            if goes_ahead:
                return None
            message = self._channel.receive()
            if message is None:
                os._exit(0)  # nobody judges any more
            head, buffers = link.decode(message)
            self.running, self._asked = head["running"], 0
            answer = packed.decode(buffers[0])
            if head["ok"]:
                if whom == TASK_ENV:
                    self._shown.add(answer)
                return answer
        self.told = _raised(answer)
        raise self.told


class TaskEnv:
    """The environment, as a loop sees it: what benchmarks call TASK_ENV, already reset.

    Args:
        judge: who holds it.
    """

    guarded = True
    """The limits of the robot are kept, on the other side."""

    def __init__(self, judge: Judge) -> None:
        self._judge = judge

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(
            f"an evaluation loop may not use TASK_ENV.{name}: it is offered {', '.join(ENV_OPERATIONS)}"
        )

    def get_obs(self) -> ObservationDict:
        """Return the observation of the only environment."""
        obs: ObservationDict = self._judge.ask(TASK_ENV, "get_obs")
        return obs

    def get_obs_batch(
        self,
        env_idx_list: Sequence[int] | None = None,
        last_frame: bool = False,  # noqa: FBT001, FBT002 - benchmarks may pass it by position
    ) -> list[ObservationDict]:
        """Return the observations of some environments, of all running ones by default."""
        wanted = None if env_idx_list is None else list(env_idx_list)
        observations: list[ObservationDict] = self._judge.ask(TASK_ENV, "get_obs_batch", wanted, last_frame)
        return observations

    def take_action(self, action: Action) -> Any:
        """Execute one action step in the only environment; return its report."""
        return self._judge.ask(TASK_ENV, "take_action", action)

    def take_action_batch(self, actions: Sequence[Action], env_idx_list: Sequence[int]) -> Any:
        """Execute one action step in each of some environments; return their reports."""
        return self._judge.ask(TASK_ENV, "take_action_batch", list(actions), list(env_idx_list))

    def is_episode_end(self) -> bool:
        """Return whether the episodes of all environments have ended."""
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        """Return the indices of the environments whose episode goes on."""
        known = self._judge.known()
        if known is not None:
            return known
        running: list[int] = self._judge.ask(TASK_ENV, "get_running_env_idx_list")
        return running

    def results(self) -> list[Result]:
        """Return the outcome of every environment's episode so far."""
        told: list[dict[str, Any]] = self._judge.ask(TASK_ENV, "results")
        return told

    def finish_episode(self) -> None:
        """Tell the environment that the loop is done, where it wants to know."""
        self._judge.ask(TASK_ENV, "finish_episode")

    def render(self, env_idx: int = 0, camera: str | None = None) -> Any:
        """Return what a camera sees now, (H, W, 3) uint8 RGB, for people."""
        return self._judge.ask(TASK_ENV, "render", env_idx, camera)


class Client:
    """The policy, as a loop sees it.

    Args:
        judge: who is connected to it.
    """

    def __init__(self, judge: Judge) -> None:
        self._judge = judge

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in CLIENT_OPERATIONS:
            raise AttributeError(f"the policy's client offers {', '.join(CLIENT_OPERATIONS)}, and no {name}")
        return lambda *arguments, **options: self._judge.ask(CLIENT, name, *arguments, **options)

    def close(self) -> None:
        """Do nothing: the connection belongs to whoever judges."""


def _raised(answer: Mapping[str, Any]) -> Exception:
    """Return the exception that an answer tells of."""
    if answer["type"] == PolicyServerError.__name__:
        return PolicyServerError(answer["code"], answer["message"], answer["details"])
    return _KINDS.get(answer["type"], RuntimeError)(answer["message"])
