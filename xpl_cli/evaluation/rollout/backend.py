"""The interface of rollout backends: jobs in, results out, on whatever machines."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from xpl_cli.evaluation.records.failures import infrastructure_error
from xpl_cli.evaluation.records.model import AttemptExecution, now

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.fingerprints import Facts
    from xpl_cli.evaluation.records.model import EpisodeOutcome

LOCAL, RAY = "local", "ray"
NAMES = (LOCAL, RAY)


@dataclass(frozen=True)
class BackendConfig:
    """Where the rollouts of a run are executed, and how many at a time.

    Attributes:
        backend: one of `NAMES`.
        workers: rollout workers; None for one per core.
        servers: policy servers that the workers share; None leaves it to the backend.
        gpus: GPUs of the cluster for each policy server.
    """

    backend: str = LOCAL
    workers: int | None = 1
    servers: int | None = None
    gpus: float = 0.0


@dataclass(frozen=True)
class RolloutJob:
    """One attempt at one episode.

    Attributes:
        index: the episode's key in the plan.
        attempt: number of the attempt, from 1.
        task, setting, seed: of the episode.
        trace: whether to record curves.
        film: whether to record a video.
    """

    index: int
    attempt: int
    task: str
    setting: str
    seed: int
    trace: bool = True
    film: bool = False


@dataclass(frozen=True)
class RolloutResult:
    """The result of a job.

    Attributes:
        job: the job.
        outcome: how it ended.
        execution: when it ran, for how long, and on which worker.
        facts: of the machine; empty if unknown.
        trace: an .npz with its curves, or None.
        film: an animated WebP, or None.
        is_server_suspect: whether the policy server may have caused a failure.
    """

    job: RolloutJob
    outcome: EpisodeOutcome
    execution: AttemptExecution
    facts: Facts = field(default_factory=dict)
    trace: bytes | None = None
    film: bytes | None = None
    is_server_suspect: bool = False


class Backend(Protocol):
    """Runs rollout jobs. The caller decides whether a failed attempt is retried."""

    def free(self) -> int:
        """Return how many more jobs can start now."""

    def submit(self, job: RolloutJob) -> None:
        """Take a job; returns at once."""

    def wait(self) -> list[RolloutResult]:
        """Wait for results, at least one; each job has at most one.

        Raises:
            UserError: no job can run: for example, policy and environment do not fit.
        """

    def close(self) -> None:
        """Stop all workers and servers, including running jobs."""


def lost_rollout(job: RolloutJob, reason: str, worker: str | None = None, facts: Facts | None = None) -> RolloutResult:
    """Return the result of a job whose worker was lost."""
    execution = AttemptExecution(started=now(), wall_seconds=0.0, worker=worker)
    return RolloutResult(job, infrastructure_error(reason), execution, facts or {}, is_server_suspect=True)
