"""What a run needs of whoever plays its episodes: jobs in, outcomes out, whatever machines are between."""

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
    """Where a run is played, and how much of it at a time.

    Attributes:
        backend: one of `NAMES`.
        lanes: episodes at a time; None is as many as there are cores.
        servers: policy servers that the lanes share; None leaves it to the backend.
        gpus: of the cluster, for each policy server.
    """

    backend: str = LOCAL
    lanes: int | None = 1
    servers: int | None = None
    gpus: float = 0.0


@dataclass(frozen=True)
class RolloutJob:
    """One attempt at one episode.

    Attributes:
        index: the episode's key in the plan.
        attempt: which attempt this is, from 1 on.
        task, setting, seed: what is played.
        trace: whether curves are wanted.
        film: whether a film is wanted.
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
    """What came of a job.

    Attributes:
        job: the job.
        ending: how it ended.
        conduct: when it was played, for how long, and by whom.
        facts: the machine on which it was played; empty where that is not known.
        trace: an .npz with its curves, or None.
        film: an animated WebP, or None.
        is_server_suspect: whether the policy server may be why it broke off.
    """

    job: RolloutJob
    ending: EpisodeOutcome
    conduct: AttemptExecution
    facts: Facts = field(default_factory=dict)
    trace: bytes | None = None
    film: bytes | None = None
    is_server_suspect: bool = False


class Backend(Protocol):
    """Runs rollout jobs. The caller decides whether a failed attempt is retried."""

    def free(self) -> int:
        """Return how many more jobs can be played at once now."""

    def submit(self, job: RolloutJob) -> None:
        """Take a job; returns at once."""

    def wait(self) -> list[RolloutResult]:
        """Wait for outcomes, at least one; each job has at most one.

        Raises:
            UserError: no job can be played: for example, policy and environment do not fit.
        """

    def close(self) -> None:
        """End everything, also what is being played."""


def lost_rollout(job: RolloutJob, reason: str, worker: str | None = None, facts: Facts | None = None) -> RolloutResult:
    """Return the outcome of a job whose player is gone."""
    conduct = AttemptExecution(started=now(), wall_seconds=0.0, worker=worker)
    return RolloutResult(job, infrastructure_error(reason), conduct, facts or {}, is_server_suspect=True)
