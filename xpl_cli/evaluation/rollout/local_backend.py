"""The local backend: rollout workers and policy servers in processes of this machine.

A thread of this process manages each worker: it starts the server, sends the worker a job and waits. Workers and
    servers
end when this process ends, for whatever reason.
"""

from __future__ import annotations

import contextlib
import platform
import queue
import socket
import subprocess
import threading
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from xpl.process import spawn
from xpl_cli.basics import module_command
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.rollout.backend import RolloutJob, RolloutResult, lost_rollout
from xpl_cli.evaluation.rollout.config import RolloutConfig, ServerAccess
from xpl_cli.evaluation.rollout.servers import ManagedServer, ServerConfig, ServerLostError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.evaluation.rollout.in_process_backend import ServerHandle

    _Done = queue.SimpleQueue[tuple["_WorkerThread", RolloutResult | Exception]]

_GRACE_S = 10.0


def assign_servers(server_config: ServerConfig, workers: int, servers: int) -> list[tuple[ServerHandle, ServerAccess]]:
    """Distribute servers evenly over workers; return server and access of each worker.

    Args:
        server_config: how the policy is served.
        workers: number of rollout workers.
        servers: number of servers.
    """
    shares = [workers * (number + 1) // servers - workers * number // servers for number in range(servers)]
    owned = [(ManagedServer(server_config, share), share) for share in shares]
    return [(server, ServerAccess(server.token)) for server, share in owned for _ in range(share)]


class LocalBackend:
    """Runs jobs on this machine (see `xpl_cli.evaluation.rollout.backend.Backend`).

    Args:
        config: what workers run.
        reached: for each worker its policy server, and how to reach it.
    """

    def __init__(self, config: RolloutConfig, reached: Sequence[tuple[ServerHandle, ServerAccess]]) -> None:
        self._servers = list(dict.fromkeys(server for server, _ in reached))
        self._done: _Done = queue.SimpleQueue()
        self._workers = [_WorkerThread(config, number, *each, self._done) for number, each in enumerate(reached)]
        self._idle = list(self._workers)
        self._returned: list[RolloutJob] = []
        for worker in self._workers:
            worker.start()

    def free(self) -> int:
        """Return how many workers are idle; 0 while a returned job waits."""
        return 0 if self._returned else len(self._idle)

    def submit(self, job: RolloutJob) -> None:
        """Give a job to the worker that has been idle longest."""
        self._idle.pop(0).jobs.put(job)

    def wait(self) -> list[RolloutResult]:
        """Wait for the next result; empty if a worker returned its job.

        Raises:
            UserError: no job can run.
        """
        worker, result = self._done.get()
        if isinstance(result, Exception):
            raise result
        if worker.is_sound:
            self._idle.append(worker)
        else:
            self._dismiss(worker, result)
        while self._returned and self._idle:
            self.submit(self._returned.pop(0))
        return [result] if worker.is_sound else []

    def _dismiss(self, worker: _WorkerThread, result: RolloutResult) -> None:
        """Remove a worker without a server: it would fail one job after the other, faster than others run them."""
        self._workers.remove(worker)
        worker.end()
        if not self._workers:
            reason = str(result.outcome.error)
            raise UserError(reason, hint="fix the cause and continue with --resume", code=ExitCode.NOT_RUN)
        self._returned.append(result.job)

    def close(self) -> None:
        """Stop workers and servers, including running jobs."""
        for worker in self._workers:
            worker.end()
        for worker in self._workers:
            worker.join(_GRACE_S)
        for server in self._servers:
            server.close()


class _WorkerThread(threading.Thread):
    """Manages one worker: its process and its policy server.

    Attributes:
        jobs: jobs to run; None ends the thread.
        is_sound: whether it can run jobs; False once its server no longer starts.
    """

    def __init__(
        self,
        config: RolloutConfig,
        number: int,
        server: ServerHandle,
        access: ServerAccess,
        done: _Done,
    ) -> None:
        # A daemon: it may wait for a model to load, and an interrupted run must end nevertheless.
        super().__init__(daemon=True)
        self.jobs: queue.SimpleQueue[RolloutJob | None] = queue.SimpleQueue()
        self._worker = f"{platform.node()}/{number}"
        self._process = _WorkerProcess(config, self._worker, access)
        self._server = server
        self._done = done
        self._is_busy = False
        self.is_sound = True

    def run(self) -> None:
        """Run jobs until None arrives."""
        while (job := self.jobs.get()) is not None:
            self._is_busy = True
            try:
                result: RolloutResult | Exception = self._run_job(job)
            except Exception as error:  # noqa: BLE001 - raised where the run is led
                result = error
            self._is_busy = False
            self._done.put((self, result))
        self._process.close()

    def end(self) -> None:
        """Stop the running job and let the thread end."""
        self.jobs.put(None)
        if self._is_busy:
            self._process.kill()

    def _run_job(self, job: RolloutJob) -> RolloutResult:
        try:
            url = self._server.url()
        except ServerLostError as error:
            self.is_sound = False
            return lost_rollout(job, f"the policy server does not start any more: {error}", self._worker)
        try:
            result = self._process.run_job(job, url)
        except WorkerLostError as error:
            result = lost_rollout(job, str(error), self._worker)
        if result.is_server_suspect:
            self._server.drop()
        return result


class WorkerLostError(RuntimeError):
    """The process of a worker has ended."""


class _WorkerProcess:
    """A worker in a process of its own (`worker_process`), which is started when it is needed."""

    def __init__(self, config: RolloutConfig, worker: str, access: ServerAccess) -> None:
        self._worker_arguments = config, worker, access
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: Connection[Any, Any] | None = None

    def run_job(self, job: RolloutJob, url: str) -> RolloutResult:
        """Run a job.

        Raises:
            UserError: no job can run.
            WorkerLostError: the process ended.
        """
        try:
            channel = self._channel or self._start_process()
            channel.send((job, url))
            result: RolloutResult | Exception = channel.recv()
        except (EOFError, OSError):
            raise WorkerLostError(self._end_process()) from None
        if isinstance(result, Exception):
            raise result
        return result

    def kill(self) -> None:
        """Let the process stop its job, close its environment and end; the waiting thread cleans up."""
        process = self._process
        if process is not None:
            process.terminate()

    def close(self) -> None:
        """Let the process end, or end it where that takes too long."""
        if self._channel is not None:
            with contextlib.suppress(OSError):
                self._channel.send(None)
            self._end_process()

    def _start_process(self) -> Connection[Any, Any]:
        # Not by `multiprocessing`, which would run the caller's main module again in the worker.
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [*module_command.command("xpl_cli.evaluation.rollout.worker_process"), str(theirs.fileno())],
                stdin=subprocess.PIPE,  # ends with this process, and the worker with it
                stdout=2,  # what an adapter's loop prints is no data
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._channel = Connection(ours.detach())
        self._channel.send(self._worker_arguments)
        return self._channel

    def _end_process(self) -> str:
        """Clear up after a process that has ended, or is to, and return how it did."""
        process, channel = self._process, self._channel
        self._process = self._channel = None
        if channel is not None:
            channel.close()
        if process is None:
            return "the process of the rollout worker cannot be started"
        try:
            code = process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            spawn.end_group(process.pid)
            code = process.wait()
        assert process.stdin is not None  # noqa: S101 - for the type checker: PIPE was asked for
        process.stdin.close()
        return f"the process of the rollout worker {spawn.describe_exit(code)}"
