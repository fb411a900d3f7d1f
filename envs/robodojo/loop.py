"""RoboDojo's own evaluation loop, with the mock: batches of layouts, two resets, deploy.py called by keyword.

Source: RoboDojo-Benchmark/RoboDojo, src/eval_client/main.py and run_eval of eval_env.py at 36bfcb7. There, exceptions
    are
printed and the layouts of their batch count as finished; here they end the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .task_env import RoboDojoEnv

SINGLE, BATCH = "eval_one_episode", "eval_one_episode_batch"


def evaluate(env: RoboDojoEnv, deploy: Any, model_client: Any, layouts: Sequence[int]) -> list[dict[str, Any]]:
    """Run layouts, as many at once as there are environments.

    Args:
        env: the mock; `eval_batch` selects the function of deploy.py.
        deploy: the adapter's deploy.py, a module.
        model_client: `call(func_name=..., obs=...)` runs an operation of the policy.
        layouts: their numbers, in order.

    Returns:
        results of each layout, as of `RoboDojoEnv.results`.

    Raises:
        AttributeError: deploy.py has no such function.
        RuntimeError: it returned before all episodes had ended.
    """
    play = getattr(deploy, BATCH if env.eval_batch else SINGLE)
    env.model_client = model_client
    results: list[dict[str, Any]] = []
    for first in range(0, len(layouts), env.num_envs):
        batch = list(layouts[first : first + env.num_envs])
        env.reset(seed=batch)
        play(TASK_ENV=env, model_client=model_client)
        running = env.get_running_env_idx_list()
        if running:
            raise RuntimeError(f"{play.__name__} returned while environments {running} still run; run them to the end")
        results += env.results()[: len(batch)]
    return results
