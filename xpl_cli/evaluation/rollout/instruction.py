"""Tells a policy something else than what it is to do, to see whether it heeds what it is told.

The task stays the same, and is judged as ever. A policy that succeeds all the same does not read.
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
"""Seeds that are looked at for one that is about something else."""


def with_instruction(env: TaskEnv, instead: str, jobs: Sequence[RolloutJob], num_envs: int) -> InstructionWrapper:
    """Return an environment whose observations hold other instructions; it has to be reset afterwards.

    Args:
        env: the environment.
        instead: `blank` for an empty text; `swap` for what the episode of the next seed is told that is told another
            one. Which that is depends on nothing but the seed.
        jobs: the episodes that are to be played.
        num_envs: environments at once.

    Raises:
        UserError: none of the next seeds is told anything else, or the environment refuses a seed.
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
        f"{jobs[0].task}, {jobs[0].setting}: episodes of the next {_TRIES} seeds are told nothing else; "
        "--instruction swap is for tasks whose instruction differs from episode to episode"
    )


def _instructions(env: TaskEnv, jobs: Sequence[RolloutJob], ahead: int, num_envs: int) -> list[str]:
    """Return what the episodes so many seeds ahead are told."""
    reset_envs(env, [replace(job, seed=job.seed + ahead) for job in jobs], num_envs)
    try:
        observations = env.get_obs_batch(list(range(len(jobs))))
    except (EnvLostError, EnvRaisedError) as error:
        raise InfrastructureError(str(error)) from None
    return [get_instruction(obs) or "" for obs in observations]


class InstructionWrapper(TaskEnvWrapper):
    """A task environment that tells something else in each place.

    Args:
        task_env: the environment.
        texts: what is told instead, by environment.
    """

    def __init__(self, task_env: TaskEnv, texts: Sequence[str]) -> None:
        super().__init__(task_env)
        self._texts = list(texts)

    def _on_observation(self, env: int, obs: ObservationDict) -> ObservationDict:
        rest = {key: value for key, value in obs.items() if key not in (sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS)}
        return {**rest, sdk.Obs.INSTRUCTION: self._texts[env]}
