"""Execute the untrusted requests of an evaluation loop on environment and policy, where episodes are judged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.action import ActionError
from xpl.client.errors import ClientError, PolicyServerError
from xpl.loop.proxies import CLIENT, TASK_ENV
from xpl.process import link
from xpl.simulator.process import EnvLostError, EnvRaisedError
from xpl.wire import packed

if TYPE_CHECKING:
    from collections.abc import Callable

    from xpl.contract import Payload, Result
    from xpl.environment import TaskEnv
    from xpl.loop.shared_arrays import SharedArrays
    from xpl.wire.arrays import Data
    from xpl_cli.evaluation.loop.messages import LoopRequest

_MAX_AFTER_END = 100
"""Requests after the end of the episode, after which a loop counts as endless."""
_MAX_WITHOUT_STEP = 10_000
"""Operations between two control steps, after which a loop is taken to go on for ever."""
_STEPS = ("take_action", "take_action_batch")
_FINISH, _RENDER, _RESULTS = "finish_episode", "render", "results"
_WITHHELD = ("layout", sdk.Deploy.SEED, "digest")
"""Results with object positions or hashes of them. A loop must see only what cameras and robot observe."""
_BATCH_OPERATIONS = ("get_obs_batch", "take_action_batch")


class LoopError(Exception):
    """The adapter's evaluation loop failed in its episode, which is a failure of the policy."""


class EndlessLoopError(LoopError):
    """A loop goes on for ever."""


class LoopRequestHandler:
    """Executes the requests of a loop in one trial.

    Args:
        task_env: the environment, reset.
        client: the policy.
        shared: arrays that the loop's process has received.

    Attributes:
        rejected: the last error of environment or policy that the loop gets as an answer.
        is_unreported: whether the loop has not got it yet.
    """

    def __init__(self, task_env: TaskEnv, client: Any, shared: SharedArrays) -> None:
        self._env = task_env
        self._client = client
        self._shared_arrays = shared
        self._idle = 0
        self.rejected: Exception | None = None
        self.is_unreported = False

    @property
    def running(self) -> list[int]:
        """Indices of the environments whose episode goes on."""
        return [int(index) for index in self._env.get_running_env_idx_list()]

    def answer(self, question: LoopRequest) -> list[Data] | None:
        """Return the pieces of the answer to a question; None where it goes ahead, and is not waited for.

        Raises:
            EndlessError: there were too many of them without a control step.
            EnvLostError, EnvRaisedError, ClientError: environment or policy failed, and the loop need not know.
        """
        self._check_progress(question.operation)
        value = None if self.is_unreported else self._execute(question)
        if question.ahead:
            return None
        is_refused, self.is_unreported = self.is_unreported, False
        if is_refused and self.rejected is not None:
            return self._encode(_describe_error(self.rejected), ok=False)
        if question.target == TASK_ENV:
            self._shared_arrays.add(value)
        return self._encode(value, ok=True)

    def _execute(self, question: LoopRequest) -> Any:
        """Run an operation and return its result; an error is stored for the loop."""
        operation = question.operation
        try:
            if question.target == TASK_ENV:
                value = _call_env(self._env, operation, question.arguments, question.options)
                return [_public_result(result) for result in value] if operation == _RESULTS else value
            return getattr(self._client, operation)(*question.arguments, **question.options)
        except (ActionError, ClientError, ValueError, TypeError, AttributeError) as error:
            if isinstance(error, ClientError) and error.is_infrastructure_error:
                raise
            self.rejected, self.is_unreported = error, True
        except (EnvLostError, EnvRaisedError):
            raise
        except Exception as error:
            if question.target == CLIENT:
                raise
            raise EnvRaisedError(type(error).__name__, str(error)) from error
        return None

    def _encode(self, value: Any, *, ok: bool) -> list[Data]:
        return link.encode({"ok": ok, "running": self.running}, [b"".join(packed.encode(value))])

    def _check_progress(self, operation: str) -> None:
        running = self.running
        self._idle = 0 if running and operation in _STEPS else self._idle + 1
        if self._idle > (_MAX_WITHOUT_STEP if running else _MAX_AFTER_END):
            raise EndlessLoopError(
                "its evaluation loop sends requests without a control step"
                if running
                else "its evaluation loop does not notice that the episode has ended, and goes on for ever"
            )


def _public_result(result: Result) -> Result:
    """Return the result of an episode without what a loop must not see."""
    return {key: value for key, value in result.items() if key not in _WITHHELD}


def _call_env(env: TaskEnv, operation: str, arguments: list[Any], options: dict[str, Any]) -> Any:
    """Run an operation of the environment, if its arguments are valid.

    An exception of the environment counts as the environment's failure, so a loop must not be able to cause one:
    invalid arguments do not reach it, a running episode cannot be ended, and an image that it cannot render is only
    refused.

    Raises:
        TypeError, ValueError: the arguments are invalid.
    """
    function: Callable[..., Any] | None = getattr(env, operation, None)
    if function is None:
        if operation == _FINISH:  # which few environments want to hear of
            return None
        raise AttributeError(f"this environment has no {operation}")
    if options:
        raise TypeError(f"{operation} takes no keyword arguments, got {', '.join(map(str, options))}")
    if operation in _BATCH_OPERATIONS:
        _check_lists(operation, arguments)
    if operation == _FINISH and env.get_running_env_idx_list():
        return None
    try:
        return function(*arguments)
    except EnvRaisedError as error:
        if operation == _RENDER:  # which changes nothing: the environment goes on
            raise ValueError(str(error)) from None
        raise


def _describe_error(error: Exception) -> Payload:
    """Return the description of an error, which the loop's process raises again."""
    if isinstance(error, PolicyServerError):
        text, kind = str(error).removeprefix(f"{error.code}: "), PolicyServerError.__name__
        return {"type": kind, "code": error.code, "message": text, "details": {"reason": error.details.get("reason")}}
    kinds = (ActionError, ClientError, AttributeError, TypeError, ValueError)
    name = next(kind.__name__ for kind in kinds if isinstance(error, kind))
    return {"type": name, "message": str(error)}


def _check_lists(operation: str, arguments: list[Any]) -> None:
    """Check the lists that an operation of several environments takes.

    Raises:
        TypeError, ValueError: they are none, or name an environment twice.
    """
    indices = arguments[1 if operation in _STEPS else 0] if len(arguments) == 2 else ()
    if indices is not None and not (isinstance(indices, list) and all(type(index) is int for index in indices)):
        raise TypeError(f"{operation} takes a list of indices of environments, got {indices!r:.80}")
    if indices is not None and len(set(indices)) != len(indices):
        raise ValueError(f"{operation} takes each environment once, got {indices!r:.80}")
    if operation in _STEPS and not isinstance(arguments[0], list):
        raise TypeError(f"{operation} takes a list of actions, got {type(arguments[0]).__name__}")
