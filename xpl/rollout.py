"""Evaluation loop: observe, run inference, execute the actions of the execution horizon.

    results = run_batch(task_env, client, horizon=8)

`reset -> (get_obs -> update_obs -> get_action -> for each action: take_action, and update_obs with the new observation
between actions)`. The loop chooses the execution horizon, the number of actions of a chunk that are executed. The
environment itself, or a guard in front of it, enforces the robot's limits; without either nothing is executed.
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
    """Neither the environment nor a guard enforces the robot's limits."""


class PolicyClient(Protocol):
    """Runs operations of a policy by name, as `xpl.Client` does."""

    def call(self, func_name: str, obs: Any = None) -> Any:
        """Run an operation and return its result."""


def run_episode(task_env: TaskEnv, client: PolicyClient, *, horizon: int | None = None) -> Result:
    """Run one episode in the only environment and return its result.

    Args:
        task_env: the environment, already reset.
        client: `call(func_name=..., obs=...)` runs an operation of the policy, as `xpl.Client` does.
        horizon: execution horizon: most actions of a chunk that are executed; all by default.

    Raises:
        UnguardedError: neither the environment nor a guard enforces the robot's limits.
        ActionError: a chunk is empty or no list, or the environment refuses an action.
        ValueError: the horizon is less than 1.
        ClientError: the policy server fails.
    """
    client = _check_and_observe(task_env, client, horizon)
    client.call(func_name=spec.Method.RESET)
    if not task_env.is_episode_end():
        client.call(func_name=spec.Method.UPDATE_OBS, obs=task_env.get_obs())
    while not task_env.is_episode_end():
        chunk = client.call(func_name=spec.Method.GET_ACTION)
        for action in chunk[: _length([chunk], horizon)]:
            report = task_env.take_action(action)
            if task_env.is_episode_end():  # it may end within a chunk
                break
            client.call(func_name=spec.Method.UPDATE_OBS, obs=task_env.get_obs())
            if _holds_pose(report):
                break
    result: Result = task_env.results()[0]
    return result


def run_batch(task_env: TaskEnv, client: PolicyClient, *, horizon: int | None = None) -> list[Result]:
    """Run one episode in each environment of a batch and return the results.

    Each step is one `update_obs_batch` of the running environments. The chunks of one inference are executed in
    parallel, up to the length of the shortest.

    Args:
        task_env: the environments, already reset.
        client: see `run_episode`.
        horizon: execution horizon: most actions of a chunk that are executed; all by default.

    Raises:
        UnguardedError, ActionError, ValueError, ClientError: see `run_episode`.
    """
    client = _check_and_observe(task_env, client, horizon)
    client.call(func_name=spec.Method.RESET)
    running: list[int] = list(task_env.get_running_env_idx_list())
    if running:
        _send_observations(task_env, client, running)
    while running and not task_env.is_episode_end():  # some environments report only one of the two
        answer = client.call(func_name=spec.Method.GET_ACTION_BATCH, obs=running)
        if not isinstance(answer, Sequence) or len(answer) != len(running):
            raise ActionError(f"expected one chunk for each of the environments {running}, got {_many(answer)}")
        chunks = dict(zip(running, answer))
        for step in range(_length(answer, horizon)):
            reports = task_env.take_action_batch([chunks[env][step] for env in running], running)
            held_envs = [env for env, report in zip(running, reports or ()) if _holds_pose(report)]
            alive = set(task_env.get_running_env_idx_list())
            running = [env for env in running if env in alive]
            if not running or task_env.is_episode_end():
                break
            _send_observations(task_env, client, running)
            if alive.intersection(held_envs):  # the rest of the chunk is too old, too
                break
    results: list[Result] = task_env.results()
    return results


def observed_client(task_env: TaskEnv, client: PolicyClient) -> PolicyClient:
    """Return the client, observed by the guard (`xpl.guard`) if there is one in front of the environment."""
    listen = getattr(task_env, "listen", None)
    return client if listen is None else listen(client)


def _check_and_observe(task_env: TaskEnv, client: PolicyClient, horizon: int | None) -> PolicyClient:
    """Check guard and horizon; return the client, observed by the guard if there is one."""
    if not getattr(task_env, "guarded", False):
        raise UnguardedError(
            f"{type(task_env).__name__} does not declare that it enforces its robot's limits (guarded = True): put "
            "xpl.guard.GuardedEnv in front of it"
        )
    if horizon is not None and horizon < 1:
        raise ValueError(f"the horizon must be at least 1 action, got {horizon}")
    return observed_client(task_env, client)


def _send_observations(task_env: TaskEnv, client: PolicyClient, running: list[int]) -> None:
    """Send the newest observations to the policy, each with the index of its environment."""
    observations = zip(running, task_env.get_obs_batch(running))
    batch = [obs if spec.Obs.ENV_IDX in obs else {**obs, spec.Obs.ENV_IDX: env} for env, obs in observations]
    client.call(func_name=spec.Method.UPDATE_OBS_BATCH, obs=batch)


def _length(chunks: Sequence[Any], horizon: int | None) -> int:
    """Return the number of actions of each chunk that are executed."""
    for chunk in chunks:
        if isinstance(chunk, (str, bytes)) or not isinstance(chunk, Sequence) or not chunk:
            raise ActionError(f"an action chunk must be a list of at least one action step, got {_many(chunk)}")
    shortest = min(map(len, chunks))
    return shortest if horizon is None else min(horizon, shortest)


def _many(value: object) -> str:
    return f"{len(value)}" if isinstance(value, Sequence) else type(value).__name__


def _holds_pose(report: object) -> bool:
    """Return whether the guard held the pose instead of executing an action."""
    return isinstance(report, Mapping) and report.get("hold_reason") is not None
