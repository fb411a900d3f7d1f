"""The requests that wait for one worker, free of I/O: in which order and in which batches they run."""

from __future__ import annotations

import collections
import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl_cli.serving.requests import is_optional

if TYPE_CHECKING:
    from xpl.wire.codec import Frame
    from xpl_cli.serving.requests import ReplayEntry
    from xpl_cli.serving.slots import WorkerSlot

_ACTIONS = frozenset((spec.Method.INFER, spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH))
_MAX_CONSECUTIVE = 16
"""Requests of one client that are sent to its worker at once: an action and the updates before it."""
_MAX_WAIT_SHARE = 0.25
"""Longest wait for others, as a part of the time that the model took last."""
_PAUSE_TOLERANCE = 2.0
"""A client is expected until it has thought this many times as long as it usually does."""
_MEAN_WEIGHT = 0.3
"""Weight of the newest value in running means."""


@dataclass(eq=False)
class RequestJob:
    """A request in the line.

    Attributes:
        frame: the request.
        method: what the worker is to do: `infer`, or the method that is called.
        place: for whom.
        payload: entries that go to the worker, as a packed map; None while its images are being decoded.
        segment: number of the shared memory that its arrays may lie in.
        entry: where its answer is remembered; None if nobody is told.
        packs: the client reads packed answers.
        size: bytes of the request.
        received: when it came, s.
        arrived: when it was put into the line, s.
        started: when it was sent to the worker, s.
    """

    frame: Frame
    method: str
    slot: WorkerSlot
    payload: bytes | None = None
    segment: int | None = None
    entry: ReplayEntry | None = None
    packs: bool = False
    size: int = 0
    received: float = 0.0
    arrived: float = 0.0
    started: float = 0.0

    @property
    def ready(self) -> bool:
        """Whether its payload is there."""
        return self.payload is not None

    def set_payload(self, payload: bytes) -> None:
        """Take the payload as the worker reads it, and let go of the one that came."""
        self.frame, self.payload = dataclasses.replace(self.frame, payload={}), payload

    def request(self) -> tuple[int, str, int | None, bool]:
        """Return what the worker is sent besides the payload."""
        return self.slot.client, self.method, self.segment, is_optional(self.frame)


@dataclass
class _ClientTiming:
    """How a client of a shared worker behaves.

    Attributes:
        answered: when it got its last action, s.
        pause: how long it usually takes until it asks for the next one, s; None before that is known.
    """

    answered: float
    pause: float | None = None


@dataclass
class JobQueue:
    """The line of one worker. Requests of one client run in their order; clients of a shared worker run together.

    Args:
        shared: whether several clients use the worker.
        most: most requests in one batch.
    """

    shared: bool = False
    max_batch: int | None = None
    _jobs: dict[WorkerSlot, collections.deque[RequestJob]] = field(default_factory=dict)
    _client_timings: dict[WorkerSlot, _ClientTiming] = field(default_factory=dict)
    _model_s: float = 0.0
    _idle_since: float = 0.0

    def __len__(self) -> int:
        return sum(map(len, self._jobs.values()))

    def add(self, job: RequestJob, now: float) -> None:
        """Put a job at the end of its client's line."""
        job.arrived = now
        self._jobs.setdefault(job.slot, collections.deque()).append(job)
        habit = self._client_timings.get(job.slot)
        if habit is not None and habit.answered and job.method in _ACTIONS:
            pause = now - habit.answered
            habit.pause = pause if habit.pause is None else _mean(habit.pause, pause)
            habit.answered = 0.0

    def next_batch(self, now: float) -> tuple[list[RequestJob], float]:
        """Return the jobs to run now, or none and how long to wait, s, for a client that is about to ask.

        A batch may wait if others are expected within a part of what the model takes anyway; a client that is alone
        never waits.
        """
        heads = [jobs[0] for jobs in self._jobs.values() if jobs and jobs[0].ready]
        if not heads:
            return [], 0.0
        if not self.shared:
            return self._take_out(self._consecutive_jobs(heads[0].slot), now), 0.0
        asking = [job for job in heads if job.method in _ACTIONS]
        if len(asking) < len(heads):  # what only updates or resets is done at once, so that it is ready for the batch
            return self._take_out([job for job in heads if job not in asking], now), 0.0
        batch = sorted(asking, key=lambda job: job.arrived)[: self.max_batch]
        wait = 0.0 if len(batch) == self.max_batch else self._wait_for_others(batch, now)
        return ([], wait) if wait > 0.0 else (self._take_out(batch, now), 0.0)

    def finished(self, jobs: list[RequestJob], now: float) -> None:
        """Learn from what was answered just now how long the model and its clients take."""
        self._idle_since = now
        if any(job.method in _ACTIONS for job in jobs):
            took = now - jobs[0].started
            self._model_s = took if not self._model_s else _mean(self._model_s, took)
        if self.shared:
            for job in jobs:
                if job.method in _ACTIONS:
                    self._client_timings.setdefault(job.slot, _ClientTiming(now)).answered = now

    def forget(self, slot: WorkerSlot) -> None:
        """Expect nothing more from a client that left."""
        self._client_timings.pop(slot, None)

    def remove(self, job: RequestJob) -> None:
        """Take one job out, if it is still there."""
        jobs = self._jobs.get(job.slot)
        if jobs is not None and job in jobs:
            jobs.remove(job)
            if not jobs:
                del self._jobs[job.slot]

    def has_jobs_of(self, slot: WorkerSlot) -> bool:
        """Tell whether jobs of a client wait."""
        return slot in self._jobs

    def clear(self) -> list[RequestJob]:
        """Take all jobs out and return them."""
        jobs = [job for line in self._jobs.values() for job in line]
        self._jobs.clear()
        return jobs

    def _consecutive_jobs(self, slot: WorkerSlot) -> list[RequestJob]:
        row: list[RequestJob] = []
        for job in self._jobs[slot]:
            if not job.ready or len(row) == _MAX_CONSECUTIVE:
                break
            row.append(job)
            if job.method not in (spec.Method.UPDATE_OBS, spec.Method.UPDATE_OBS_BATCH):
                break
        return row

    def _take_out(self, jobs: list[RequestJob], now: float) -> list[RequestJob]:
        for job in jobs:
            job.started = now
            self._jobs[job.slot].popleft()
            if not self._jobs[job.slot]:
                del self._jobs[job.slot]
        return jobs

    def _wait_for_others(self, batch: list[RequestJob], now: float) -> float:
        """Return how long to wait for clients that will ask within our patience, s."""
        until = max(self._idle_since, min(job.arrived for job in batch)) + _MAX_WAIT_SHARE * self._model_s
        asking = {job.slot for job in batch}
        due = [
            min(habit.answered + _PAUSE_TOLERANCE * habit.pause, until)
            for place, habit in self._client_timings.items()
            if place not in asking and habit.answered and habit.pause and habit.answered + habit.pause <= until
        ]
        # Who has asked already, and has its images decoded still.
        decoding = any(
            place not in asking and not jobs[0].ready and any(job.method in _ACTIONS for job in jobs)
            for place, jobs in self._jobs.items()
        )
        return max(0.0, *(time - now for time in (*due, until if decoding else now)))


def _mean(old: float, new: float) -> float:
    return (1.0 - _MEAN_WEIGHT) * old + _MEAN_WEIGHT * new
