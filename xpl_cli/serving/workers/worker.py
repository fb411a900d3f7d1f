"""A worker at work: its process, its line, its deadlines, and what is told when it fails."""

from __future__ import annotations

import asyncio
import collections
import sys
import time
from typing import TYPE_CHECKING, Protocol

from xpl import _spec as spec
from xpl.wire.frame import PackingError
from xpl_cli.isolation.stacks import STACKS_S
from xpl_cli.serving.requests import RequestError
from xpl_cli.serving.server_log import log
from xpl_cli.serving.workers.job_queue import JobQueue
from xpl_cli.serving.workers.process import WorkerDiedError
from xpl_cli.serving.workers.worker_answers import AdapterException, WorkerAnswerError, parse_answers, parse_result

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from xpl.contract import Config
    from xpl.manifest import Manifest
    from xpl.process.link import Head
    from xpl.wire.arrays import Data
    from xpl_cli.serving.slots import WorkerSlot
    from xpl_cli.serving.workers.job_queue import RequestJob
    from xpl_cli.serving.workers.process import Answered, WorkerProcess

_REPORT_S = 10.0
"""A request that takes longer is reported while it runs, and again whenever it has taken twice as long."""


class JobListener(Protocol):
    """What a worker tells about its jobs."""

    def job_answered(self, job: RequestJob, result: memoryview) -> None:
        """Pass on the answer to a job, packed."""

    def job_raised(self, job: RequestJob, error: AdapterException) -> None:
        """Say what the adapter raised, or why its result cannot travel."""

    def job_refused(self, job: RequestJob, error: RequestError) -> None:
        """Say that a job was not done."""

    def job_failed(self, job: RequestJob, error: Exception) -> None:
        """Say that its answer could not be given, by a fault of ours."""


class ModelLoadError(Exception):
    """The model could not be loaded.

    Attributes:
        lacks: what the machine lacks, if that is why: `kind` and `name` (`xpl.worker.lacking`).
    """

    def __init__(self, reason: str, lacks: Mapping[str, str] | None = None) -> None:
        super().__init__(reason)
        self.lacks = lacks


class ModelWorker:
    """One copy of the model.

    Args:
        number: which one, from 0.
        process: its process.
        timeout: longest time for one batch, s; None means no limit.
        desk: told what becomes of the jobs.
        on_failure: told once if the worker cannot go on, with the reason.
    """

    def __init__(
        self,
        number: int,
        process: WorkerProcess,
        timeout: float | None,
        listener: JobListener,
        on_failure: Callable[[ModelWorker, str], None],
    ) -> None:
        self.number = number
        self.process = process
        self.queue = JobQueue()
        self.failed = False
        self.shares_memory = True
        self._timeout = timeout
        self._stacks_after = max(0.0, 0.5 * (timeout or 0.0), (timeout or 0.0) - STACKS_S)
        self._listener = listener
        self._on_failure = on_failure
        self._loop = asyncio.get_running_loop()
        self._control_messages: collections.deque[tuple[Head, Callable[[str | None], None]]] = collections.deque()
        self._running: list[RequestJob] = []
        self._deferred: list[tuple[WorkerSlot, Callable[[], None]]] = []
        self._loading: Head = {}
        self._busy = False
        self._started = 0.0
        self._check_timer: asyncio.TimerHandle | None = None
        self._reported = 0.0
        self._batch_timer: asyncio.TimerHandle | None = None
        process.died.add_done_callback(lambda died: self.fail(died.result()))

    async def load(self, policy_dir: Path, config: Config, manifest: Manifest, *, shadow: bool = False) -> None:
        """Load the adapter; with `shadow` not its model (`xpl.worker.shadow`).

        Raises:
            LoadError: with one sentence that says why it could not be loaded.
        """
        request = {"policy_dir": str(policy_dir), "config": dict(config), "manifest": dict(manifest.data)}
        self._loading = {"op": "load", **request, **({"shadow": True} if shadow else {})}
        self._busy, self._started = True, time.monotonic()
        try:
            offered = parse_result(await self.process.request(**self._loading))
        except (WorkerDiedError, PackingError, WorkerAnswerError) as error:
            raise ModelLoadError(f"the model could not be loaded: {error}") from None
        if isinstance(offered, AdapterException):
            sys.stderr.write(offered.traceback)
            raise ModelLoadError(f"the model could not be loaded: {offered.kind}: {offered.message}", offered.lacks)
        self._busy = False
        self.queue = JobQueue(shared=manifest.serving.shared, max_batch=manifest.serving.max_batch)

    def rebuild_model(self) -> None:
        """Build the model anew before the next request."""
        self.send_control(self._loading, self._finish_rebuild)

    def busy_for(self) -> float:
        """Return for how long the model has been at work, s; 0 if it is idle."""
        return time.monotonic() - self._started if self._busy else 0.0

    def submit(self, job: RequestJob) -> None:
        """Put a job into the line."""
        if self.failed:
            self._listener.job_refused(job, _worker_died("the worker has ended"))
            return
        self.queue.add(job, time.monotonic())
        self.send_next()

    def send_control(self, message: Head, on_answer: Callable[[str | None], None]) -> None:
        """Send a message that is no request, before the next batch; `on_answer` is told what went wrong, or None."""
        self._control_messages.append((message, on_answer))
        self.send_next()

    def call_when_done(self, slot: WorkerSlot, action: Callable[[], None]) -> None:
        """Do something once no job of a client waits or runs any more."""
        if self.failed:
            return
        if self.queue.has_jobs_of(slot) or any(job.slot is slot for job in self._running):
            self._deferred.append((slot, action))
        else:
            action()

    def send_next(self) -> None:
        """Send the worker what it can do next, if it is idle."""
        if self._busy or self.failed:
            return
        if self._batch_timer is not None:
            self._batch_timer.cancel()
            self._batch_timer = None
        if self._control_messages:
            self._send(self._control_messages[0][0], (), lambda answer, _: self._finish_control(answer))
            return
        jobs, wait = self.queue.next_batch(time.monotonic())
        if jobs:
            self._running = jobs
            requests = [job.request() for job in jobs]
            self._send({"op": "run", "requests": requests}, [job.payload or b"" for job in jobs], self._finish_jobs)
        elif wait:
            self._batch_timer = self._loop.call_later(wait, self.send_next)

    def fail(self, reason: str, code: str = spec.ErrorCode.INTERNAL) -> None:
        """Give up: answer everything that waits, and tell why."""
        if self.failed:
            return
        self.failed = True
        for timer in (self._check_timer, self._batch_timer):
            if timer is not None:
                timer.cancel()
        died = _worker_died(reason)
        first = RequestError(code, reason, spec.ErrorReason.WORKER_DIED)
        running, self._running = self._running, []
        for job in running:
            self._listener.job_refused(job, first)
        while self._control_messages:
            self._control_messages.popleft()[1](reason)
        for job in self.queue.clear():
            self._listener.job_refused(job, died)
        self._on_failure(self, reason)

    def _send(self, head: Head, buffers: Sequence[Data], on_answer: Answered) -> None:
        self._busy, self._started = True, time.monotonic()
        if self._check_timer is None:
            self._schedule_check(self._started)
        try:
            self.process.send(head, buffers, on_answer)
        except (WorkerDiedError, PackingError) as error:
            self._loop.call_soon(self.fail, str(error))

    def _finish_jobs(self, head: Head, buffers: list[memoryview]) -> None:
        told = parse_answers(head, buffers, len(self._running))
        jobs, self._running = self._running, []
        self._busy = False
        self.queue.finished(jobs, time.monotonic())
        for job, answer in zip(jobs, told, strict=True):
            try:
                if isinstance(answer, AdapterException):
                    self._listener.job_raised(job, answer)
                else:
                    self._listener.job_answered(job, answer)
            except Exception as problem:  # noqa: BLE001 - one job of a batch never costs another its answer
                self._listener.job_failed(job, problem)
        later, self._deferred = self._deferred, []
        for place, action in later:
            self.call_when_done(place, action)
        self.send_next()

    def _finish_control(self, head: Head) -> None:
        told = parse_result(head)
        self._busy = False
        _, on_answer = self._control_messages.popleft()
        on_answer(told.message if isinstance(told, AdapterException) else None)
        self.send_next()

    def _finish_rebuild(self, error: str | None) -> None:
        if error is not None:
            self.fail(f"the model could not be built a second time: {error}")

    def _schedule_check(self, now: float) -> None:
        """Look after what runs when it should have ended: one timer for all, because most requests take no time."""
        due = self._reported or _REPORT_S
        if self._timeout is not None:
            due = min(due, self._stacks_after)
        self._check_timer = self._loop.call_later(max(0.0, self._started + due - now), self._check_running)

    def _check_running(self) -> None:
        self._check_timer = None
        now = time.monotonic()
        busy = now - self._started if self._busy else 0.0
        if not self._busy:
            self._reported = 0.0
            return
        if self._timeout is not None and busy >= self._stacks_after:
            self.process.show_stacks()
            self._check_timer = self._loop.call_later(self._timeout - self._stacks_after, self._time_out, self._started)
            return
        if busy < _REPORT_S:
            self._reported = 0.0
        elif busy >= (self._reported or _REPORT_S):
            self._log_slow(busy)
            self._reported = 2.0 * busy
        self._schedule_check(now)

    def _time_out(self, started: float) -> None:
        """End a worker that hangs, if it has not answered at the last moment."""
        self._check_timer = None
        if self._busy and self._started == started:
            self.fail(f"the model did not answer within {self._timeout:g} s", spec.ErrorCode.TIMEOUT)
        elif self._busy:
            self._schedule_check(time.monotonic())

    def _log_slow(self, busy: float) -> None:
        limit = "there is no limit" if self._timeout is None else f"it is ended after {self._timeout:g} s"
        names = ", ".join(sorted({job.method for job in self._running})) or "an errand"
        log(f"the model has been at work for {busy:.0f} s (process {self.process.adapter_pid()}, {names}); {limit}")


def _worker_died(reason: str) -> RequestError:
    return RequestError(spec.ErrorCode.INTERNAL, reason, spec.ErrorReason.WORKER_DIED)
