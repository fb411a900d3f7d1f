"""The evaluation loop in the words of the contract: an observation at the head of each chunk, and between its actions.

The scaffold's loop shows the policy the same observations in the same order, and needs no bookkeeping at a chunk's end.
This form is the one that the field writes. Nothing imports this file: `xpl_cli.loop_distance` reads it as text.
"""

from __future__ import annotations

from typing import Any


def eval_one_episode(TASK_ENV: Any, model_client: Any) -> None:  # noqa: N803 - the benchmarks' names
    """Run one episode in one environment."""
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        actions = model_client.call(func_name="get_action")
        for index, action in enumerate(actions):
            TASK_ENV.take_action(action)
            if TASK_ENV.is_episode_end() or index + 1 == len(actions):
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())


def eval_one_episode_batch(TASK_ENV: Any, model_client: Any) -> None:  # noqa: N803 - the benchmarks' names
    """Run one episode in each environment of a batch; a chunk goes on in those that are still running."""
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        envs = TASK_ENV.get_running_env_idx_list()
        model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
        chunks = model_client.call(func_name="get_action_batch", obs=envs)
        length = len(chunks[0])
        for step in range(length):
            TASK_ENV.take_action_batch([chunk[step] for chunk in chunks], envs)
            if TASK_ENV.is_episode_end() or step + 1 == length:
                break
            running = set(TASK_ENV.get_running_env_idx_list())
            chunks = [chunk for env, chunk in zip(envs, chunks, strict=True) if env in running]
            envs = [env for env in envs if env in running]
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
