"""The environment's side of an evaluation: observe, ask the policy, execute as much of a chunk as is wanted.

    results = run_batch(task_env, client, horizon=8)

`reset -> (get_obs -> update_obs -> get_action -> for each action: take_action, and update_obs with the new observation
between actions)`. How many actions of a chunk are executed, the horizon, is this side's choice. A robot's limits are
kept by the environment itself or by a guard in front of it; without either nothing is executed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from xpl import _spec as spec
from xpl.action import ActionError

if TYPE_CHECKING:
    from xpl.contract import Result
    from xpl.environment import TaskEnv


class UnguardedError(TypeError):
    """Nobody keeps the limits of the robot that is to be driven."""


class Caller(Protocol):
    """Who runs operations of a policy by name, as `xpl.Client` does."""

    def call(self, func_name: str, obs: Any = None) -> Any:
        """Run an operation and return its result."""


def run_episode(task_env: TaskEnv, client: Caller, *, horizon: int | None = None) -> Result:
    """Run one episode in the only environment and return its result.

    Args:
        task_env: the environment, already reset.
        client: `call(func_name=..., obs=...)` runs an operation of the policy, as `xpl.Client` does.
        horizon: actions of a chunk that are executed, at most; all by default.

    Raises:
        UnguardedError: neither the environment nor a guard keeps the robot's limits.
        ActionError: a chunk is empty or no list, or the environment refuses an action.
        ValueError: the horizon is less than 1.
        ClientError: the policy cannot be asked.
    """
    client = _checked(task_env, client, horizon)
    client.call(func_name=spec.Method.RESET)
    if not task_env.is_episode_end():
        client.call(func_name=spec.Method.UPDATE_OBS, obs=task_env.get_obs())
    while not task_env.is_episode_end():
        chunk = client.call(func_name=spec.Method.GET_ACTION)
        for action in chunk[: _length([chunk], horizon)]:
            report = task_env.take_action(action)
            if task_env.is_episode_end():  # it may end anywhere in a chunk
                break
            client.call(func_name=spec.Method.UPDATE_OBS, obs=task_env.get_obs())
            if _is_held(report):
                break
    result: Result = task_env.results()[0]
    return result


def run_batch(task_env: TaskEnv, client: Caller, *, horizon: int | None = None) -> list[Result]:
    """Run one episode in each environment of a batch and return the results.

    Each step is one `update_obs_batch` of the environments that still run; they end one by one. All chunks of one
    answer are executed side by side, as far as the shortest goes.

    Args:
        task_env: the environments, already reset.
        client: as for `run_episode`.
        horizon: actions of a chunk that are executed, at most; all by default.

    Raises:
        UnguardedError, ActionError, ValueError, ClientError: as for `run_episode`.
    """
    client = _checked(task_env, client, horizon)
    client.call(func_name=spec.Method.RESET)
    running: list[int] = list(task_env.get_running_env_idx_list())
    if running:
        _show(task_env, client, running)
    while running and not task_env.is_episode_end():  # which some environments tell by one of the two only
        answer = client.call(func_name=spec.Method.GET_ACTION_BATCH, obs=running)
        if not isinstance(answer, Sequence) or len(answer) != len(running):
            raise ActionError(f"expected one chunk for each of the environments {running}, got {_many(answer)}")
        chunks = dict(zip(running, answer))
        for step in range(_length(answer, horizon)):
            reports = task_env.take_action_batch([chunks[env][step] for env in running], running)
            held = [env for env, report in zip(running, reports or ()) if _is_held(report)]
            alive = set(task_env.get_running_env_idx_list())
            running = [env for env in running if env in alive]
            if not running or task_env.is_episode_end():
                break
            _show(task_env, client, running)
            if alive.intersection(held):  # the rest of the chunk is as old
                break
    results: list[Result] = task_env.results()
    return results


def listened(task_env: TaskEnv, client: Caller) -> Caller:
    """Return the client, listened to by the guard (`xpl.guard`) if there is one in front of the environment."""
    listen = getattr(task_env, "listen", None)
    return client if listen is None else listen(client)


def _checked(task_env: TaskEnv, client: Caller, horizon: int | None) -> Caller:
    """Return the client, listened to by the guard if there is one; refuse what must not be driven."""
    if not getattr(task_env, "guarded", False):
        raise UnguardedError(
            f"{type(task_env).__name__} does not say that it keeps its robot's limits (guarded = True): put "
            "xpl.guard.GuardedEnv in front of it"
        )
    if horizon is not None and horizon < 1:
        raise ValueError(f"the horizon must be at least 1 action, got {horizon}")
    return listened(task_env, client)


def _show(task_env: TaskEnv, client: Caller, running: list[int]) -> None:
    """Show the policy the newest observations; each bears the index of its environment."""
    observations = zip(running, task_env.get_obs_batch(running))
    batch = [obs if spec.Obs.ENV_IDX in obs else {**obs, spec.Obs.ENV_IDX: env} for env, obs in observations]
    client.call(func_name=spec.Method.UPDATE_OBS_BATCH, obs=batch)


def _length(chunks: Sequence[Any], horizon: int | None) -> int:
    """Return how many actions of each chunk are executed."""
    for chunk in chunks:
        if isinstance(chunk, (str, bytes)) or not isinstance(chunk, Sequence) or not chunk:
            raise ActionError(f"an action chunk must be a list of at least one action step, got {_many(chunk)}")
    shortest = min(map(len, chunks))
    return shortest if horizon is None else min(horizon, shortest)


def _many(value: object) -> str:
    return f"{len(value)}" if isinstance(value, Sequence) else type(value).__name__


def _is_held(report: object) -> bool:
    """Tell whether a guard held the pose instead of executing an action."""
    return isinstance(report, Mapping) and report.get("held") is not None
