"""Give a policy another instruction than the task's, to test whether it follows instructions.

Task and success criterion stay the same. A policy that still succeeds does not use the instruction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.observation import get_instruction
from xpl.simulator.process import EnvLostError, EnvRaisedError
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.records.run_mode import BLANK
from xpl_cli.evaluation.rollout.env_wrapper import TaskEnvWrapper
from xpl_cli.evaluation.rollout.scene import InfrastructureError, reset_envs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import ObservationDict
    from xpl.environment import TaskEnv
    from xpl_cli.evaluation.rollout.backend import RolloutJob

_TRIES = 30
"""Seeds that are searched for another instruction."""


def with_instruction(env: TaskEnv, instead: str, jobs: Sequence[RolloutJob], num_envs: int) -> InstructionWrapper:
    """Return an environment whose observations hold other instructions; it has to be reset afterwards.

    Args:
        env: the environment.
        instead: `blank` for an empty text; `swap` for the instruction of the next seed that has another one. That
            depends on the seed alone.
        jobs: the episodes to run.
        num_envs: environments in one batch.

    Raises:
        UserError: none of the next seeds has another instruction, or the environment refuses a seed.
        InfrastructureError: the environment is lost.
    """
    if instead == BLANK:
        return InstructionWrapper(env, [""] * num_envs)
    texts: list[str | None] = [None] * len(jobs)
    own = _instructions(env, jobs, 0, num_envs)
    for ahead in range(1, _TRIES + 1):
        others = _instructions(env, jobs, ahead, num_envs)
        texts = [
            text or (other if other != mine else None) for text, other, mine in zip(texts, others, own, strict=True)
        ]
        if all(texts):
            return InstructionWrapper(env, [*(text or "" for text in texts), *[""] * (num_envs - len(jobs))])
    raise UserError(
        f"{jobs[0].task}, {jobs[0].setting}: the next {_TRIES} seeds have the same instruction; "
        "--instruction swap is for tasks whose instruction differs from episode to episode"
    )


def _instructions(env: TaskEnv, jobs: Sequence[RolloutJob], ahead: int, num_envs: int) -> list[str]:
    """Return the instructions of the episodes `ahead` seeds later."""
    reset_envs(env, [replace(job, seed=job.seed + ahead) for job in jobs], num_envs)
    try:
        observations = env.get_obs_batch(list(range(len(jobs))))
    except (EnvLostError, EnvRaisedError) as error:
        raise InfrastructureError(str(error)) from None
    return [get_instruction(obs) or "" for obs in observations]


class InstructionWrapper(TaskEnvWrapper):
    """A task environment with a replaced instruction in each environment of the batch.

    Args:
        task_env: the environment.
        texts: instruction of each environment.
    """

    def __init__(self, task_env: TaskEnv, texts: Sequence[str]) -> None:
        super().__init__(task_env)
        self._texts = list(texts)

    def _on_observation(self, env: int, obs: ObservationDict) -> ObservationDict:
        rest = {key: value for key, value in obs.items() if key not in (sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS)}
        return {**rest, sdk.Obs.INSTRUCTION: self._texts[env]}
