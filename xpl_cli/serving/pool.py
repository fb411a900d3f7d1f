"""A worker at work: its process, its line, its deadlines, and what is told when it fails."""

from __future__ import annotations

import asyncio
import collections
import sys
import time
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.packed import PackingError
from xpl_cli.serving.line import Line
from xpl_cli.serving.session import RequestError
from xpl_cli.serving.worker_process import WorkerDiedError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from xpl_cli.serving.line import Job
    from xpl_cli.serving.places import Place
    from xpl_cli.serving.worker_process import WorkerProcess

_REPORT_S = 10.0
"""A request that takes longer is reported while it runs, and again whenever it has taken twice as long."""


class LoadError(Exception):
    """The model could not be loaded."""


class Worker:
    """One copy of the model.

    Args:
        number: which one, from 0.
        process: its process.
        timeout: longest time for one batch, s; None means no limit.
        on_failure: told once if the worker cannot go on, with the reason.
    """

    def __init__(
        self, number: int, process: WorkerProcess, timeout: float | None, on_failure: Callable[[Worker, str], None]
    ) -> None:
        self.number = number
        self.process = process
        self.line = Line()
        self.failed = False
        self._timeout = timeout
        self._on_failure = on_failure
        self._loop = asyncio.get_running_loop()
        self._errands: collections.deque[tuple[dict[str, Any], Callable[[dict[str, Any]], None]]] = collections.deque()
        self._running: list[Job] = []
        self._later: list[tuple[Place, Callable[[], None]]] = []
        self._busy = False
        self._started = 0.0
        self._overdue: asyncio.TimerHandle | None = None
        self._report: asyncio.TimerHandle | None = None
        self._wait: asyncio.TimerHandle | None = None
        process.died.add_done_callback(lambda died: self.fail(died.result()))

    async def load(self, policy_dir: Path, config: Mapping[str, Any], manifest: Mapping[str, Any]) -> None:
        """Load the adapter.

        Raises:
            LoadError: with one sentence that says why it could not be loaded.
        """
        request = {"policy_dir": str(policy_dir), "config": dict(config), "manifest": dict(manifest)}
        self._busy, self._started = True, time.monotonic()
        try:
            answer = await self.process.ask(op="load", **request)
        except (WorkerDiedError, PackingError) as error:
            raise LoadError(f"the model could not be loaded: {error}") from None
        if "error" in answer:
            raised = answer["error"]
            sys.stderr.write(raised["traceback"])
            raise LoadError(f"the model could not be loaded: {raised['type']}: {raised['message']}")
        self._busy = False
        serving = manifest.get("serving") or {}
        self.line = Line(shared=bool(answer["ok"]["shared"]), most=serving.get("max_batch"))

    def busy_for(self) -> float:
        """Return for how long the model has been at work, s; 0 if it is idle."""
        return time.monotonic() - self._started if self._busy else 0.0

    def submit(self, job: Job) -> None:
        """Put a job into the line."""
        if self.failed:
            job.done(job, _died("the worker has ended"))
            return
        self.line.add(job, time.monotonic())
        self.pump()

    def errand(self, message: dict[str, Any], on_answer: Callable[[dict[str, Any]], None]) -> None:
        """Send a message that is no request, before the next batch."""
        self._errands.append((message, on_answer))
        self.pump()

    def after(self, place: Place, action: Callable[[], None]) -> None:
        """Do something once no job of a client waits or runs any more."""
        if self.failed:
            return
        if self.line.holds(place) or any(job.place is place for job in self._running):
            self._later.append((place, action))
        else:
            action()

    def pump(self) -> None:
        """Send the worker what it can do next, if it is idle."""
        if self._busy or self.failed:
            return
        if self._wait is not None:
            self._wait.cancel()
            self._wait = None
        if self._errands:
            message, on_answer = self._errands.popleft()
            self._send(message, lambda answer: self._errand_done(answer, on_answer))
            return
        jobs, wait = self.line.next(time.monotonic())
        if jobs:
            self._running = jobs
            self._send({"op": "run", "requests": [job.request() for job in jobs]}, self._jobs_done)
        elif wait:
            self._wait = self._loop.call_later(wait, self.pump)

    def fail(self, reason: str, code: str = spec.ErrorCode.INTERNAL) -> None:
        """Give up: answer everything that waits, and tell why."""
        if self.failed:
            return
        self.failed = True
        self._clear_timers()
        refused = RequestError(code, reason, spec.ErrorReason.WORKER_DIED) if code == spec.ErrorCode.TIMEOUT else None
        running, self._running = self._running, []
        for job in running:
            job.done(job, refused or _died(reason))
        for job in self.line.clear():
            job.done(job, _died(reason))
        self._on_failure(self, reason)

    def _send(self, message: dict[str, Any], on_answer: Callable[[dict[str, Any]], None]) -> None:
        self._busy, self._started = True, time.monotonic()
        if self._timeout is not None:
            self._overdue = self._loop.call_later(self._timeout, self._hangs)
        self._report = self._loop.call_later(_REPORT_S, self._tell, _REPORT_S)
        try:
            self.process.send(message, on_answer)
        except (WorkerDiedError, PackingError) as error:
            self._loop.call_soon(self.fail, str(error))

    def _jobs_done(self, answer: dict[str, Any]) -> None:
        jobs, self._running = self._running, []
        self._idle()
        self.line.finished(jobs, time.monotonic())
        for job, one in zip(jobs, answer["answers"], strict=True):
            job.done(job, one)
        later, self._later = self._later, []
        for place, action in later:
            self.after(place, action)
        self.pump()

    def _errand_done(self, answer: dict[str, Any], on_answer: Callable[[dict[str, Any]], None]) -> None:
        self._idle()
        on_answer(answer)
        self.pump()

    def _idle(self) -> None:
        self._busy = False
        self._clear_timers()

    def _clear_timers(self) -> None:
        for timer in (self._overdue, self._report, self._wait):
            if timer is not None:
                timer.cancel()
        self._overdue = self._report = self._wait = None

    def _tell(self, after: float) -> None:
        limit = "there is no limit" if self._timeout is None else f"it is ended after {self._timeout:g} s"
        names = ", ".join(sorted({job.task.method for job in self._running})) or "an errand"
        log(f"the model has been at work for {after:g} s (process {self.process.pid}, {names}); {limit}")
        self._report = self._loop.call_later(after, self._tell, 2 * after)

    def _hangs(self) -> None:
        self.process.show_stacks()
        self.fail(f"the model did not answer within {self._timeout:g} s", spec.ErrorCode.TIMEOUT)


def _died(reason: str) -> RequestError:
    return RequestError(spec.ErrorCode.INTERNAL, reason, spec.ErrorReason.WORKER_DIED)


def log(text: str) -> None:
    """Write a line to the server's log, which is standard error."""
    sys.stderr.write(f"[server] {text}\n")
    sys.stderr.flush()
