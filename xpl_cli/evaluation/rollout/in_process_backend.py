"""The in-process backend: one rollout worker, one batch of environments, one policy server."""

from __future__ import annotations

import platform
from typing import TYPE_CHECKING, Protocol

from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.rollout.servers import ServerLostError
from xpl_cli.evaluation.rollout.worker import RolloutWorker

if TYPE_CHECKING:
    from xpl_cli.evaluation.rollout.backend import RolloutJob, RolloutResult
    from xpl_cli.evaluation.rollout.config import RolloutConfig, ServerAccess


class ServerHandle(Protocol):
    """A policy server of a rollout worker: one of ours (`servers.ManagedServer`) or an external one."""

    def url(self) -> str:
        """Return where it answers."""

    def drop(self) -> None:
        """End it after an attempt in which it may have failed."""

    def close(self) -> None:
        """End it."""


class ExternalServer:
    """A policy server that is started and stopped elsewhere.

    Args:
        url: its address.
    """

    def __init__(self, url: str) -> None:
        self._url = url

    def url(self) -> str:
        """Return where it answers."""
        return self._url

    def drop(self) -> None:
        """Leave it as it is."""

    def close(self) -> None:
        """Leave it as it is."""


class InProcessBackend:
    """Runs jobs in this process (see `xpl_cli.evaluation.rollout.backend.Backend`).

    Args:
        config: what is run; its environments run in one batch.
        server: the policy server.
        access: how to reach it.
    """

    def __init__(self, config: RolloutConfig, server: ServerHandle, access: ServerAccess) -> None:
        self._worker = RolloutWorker(config, f"{platform.node()}/0", access)
        self._num_envs = config.num_envs
        self._server = server
        self._jobs: list[RolloutJob] = []

    def prepare(self, task: str, setting: str) -> None:
        """Make the environment before a server is started.

        Raises:
            UserError: it cannot run.
        """
        self._worker.prepare(task, setting)

    def free(self) -> int:
        """Return how many more jobs fit in the next batch."""
        return self._num_envs - len(self._jobs)

    def submit(self, job: RolloutJob) -> None:
        """Take a job for the next batch."""
        self._jobs.append(job)

    def wait(self) -> list[RolloutResult]:
        """Run the batch and return its results.

        Raises:
            UserError: no job can run.
        """
        first = self._jobs[0]
        # A batch is of one task and setting; the others wait for the next one.
        jobs = [job for job in self._jobs if (job.task, job.setting) == (first.task, first.setting)]
        self._jobs = [job for job in self._jobs if job not in jobs]
        try:
            url = self._server.url()
        except ServerLostError as error:
            raise UserError(f"the policy server does not start any more: {error}", code=ExitCode.NOT_RUN) from None
        results = self._worker.run_jobs(jobs, url)
        if any(result.is_server_suspect for result in results):
            self._server.drop()
        return results

    def close(self) -> None:
        """Stop the worker, and the server if it is ours."""
        self._worker.close()
        self._server.close()
