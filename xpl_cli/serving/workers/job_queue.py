"""The request queue of one worker, without I/O: order and batches of its requests."""

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
"""Most requests of one client in one message to its worker: an action and the updates before it."""
_MAX_WAIT_SHARE = 0.25
"""Longest wait for other clients, as a share of the model's last inference time."""
_PAUSE_TOLERANCE = 2.0
"""A client is expected until its pause is so many times its usual one."""
_MEAN_WEIGHT = 0.3
"""Weight of the newest value in running means."""


@dataclass(eq=False)
class RequestJob:
    """A request in the queue.

    Attributes:
        frame: the request.
        method: the method to call, such as `infer`.
        slot: the client's slot.
        payload: entries for the worker, as a packed map; None while its images are decoded.
        segment: number of the shared memory that may hold its arrays.
        entry: cache entry of its answer; None if no client waits for it.
        packs: the client reads packed answers.
        size: bytes of the request.
        received: when it arrived at the server, s.
        arrived: when it was queued, s.
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
        """Whether its payload is complete."""
        return self.payload is not None

    def set_payload(self, payload: bytes) -> None:
        """Set the packed payload, and free the received one."""
        self.frame, self.payload = dataclasses.replace(self.frame, payload={}), payload

    def request(self) -> tuple[int, str, int | None, bool]:
        """Return what the worker gets besides the payload: client, method, segment, whether the method is optional."""
        return self.slot.client, self.method, self.segment, is_optional(self.frame)


@dataclass
class _ClientTiming:
    """Timing of a client of a shared worker.

    Attributes:
        answered: when it got its last action, s.
        pause: its usual time between an action and the next request, s; None before that is known.
    """

    answered: float
    pause: float | None = None


@dataclass
class JobQueue:
    """The queue of one worker. Requests of one client run in order; requests of several clients run as one batch.

    Args:
        shared: whether several clients share the worker.
        max_batch: largest batch.
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
        """Append a job to its client's queue."""
        job.arrived = now
        self._jobs.setdefault(job.slot, collections.deque()).append(job)
        timing = self._client_timings.get(job.slot)
        if timing is not None and timing.answered and job.method in _ACTIONS:
            pause = now - timing.answered
            timing.pause = pause if timing.pause is None else _mean(timing.pause, pause)
            timing.answered = 0.0

    def next_batch(self, now: float) -> tuple[list[RequestJob], float]:
        """Return the jobs to run now, or none and how long to wait for an expected client, s.

        A batch waits if other clients are expected within a share of the inference time; a single client never waits.
        """
        heads = [jobs[0] for jobs in self._jobs.values() if jobs and jobs[0].ready]
        if not heads:
            return [], 0.0
        if not self.shared:
            return self._take_out(self._consecutive_jobs(heads[0].slot), now), 0.0
        asking = [job for job in heads if job.method in _ACTIONS]
        if len(asking) < len(heads):  # updates and resets run at once, so that the next batch is complete
            return self._take_out([job for job in heads if job not in asking], now), 0.0
        batch = sorted(asking, key=lambda job: job.arrived)[: self.max_batch]
        wait = 0.0 if len(batch) == self.max_batch else self._wait_for_others(batch, now)
        return ([], wait) if wait > 0.0 else (self._take_out(batch, now), 0.0)

    def finished(self, jobs: list[RequestJob], now: float) -> None:
        """Update the timing of the model and of its clients after an answer."""
        self._idle_since = now
        if any(job.method in _ACTIONS for job in jobs):
            took = now - jobs[0].started
            self._model_s = took if not self._model_s else _mean(self._model_s, took)
        if self.shared:
            for job in jobs:
                if job.method in _ACTIONS:
                    self._client_timings.setdefault(job.slot, _ClientTiming(now)).answered = now

    def forget(self, slot: WorkerSlot) -> None:
        """Remove the timing of a client that left."""
        self._client_timings.pop(slot, None)

    def remove(self, job: RequestJob) -> None:
        """Remove a job, if it is still queued."""
        jobs = self._jobs.get(job.slot)
        if jobs is not None and job in jobs:
            jobs.remove(job)
            if not jobs:
                del self._jobs[job.slot]

    def has_jobs_of(self, slot: WorkerSlot) -> bool:
        """Tell whether jobs of a client are queued."""
        return slot in self._jobs

    def clear(self) -> list[RequestJob]:
        """Remove all jobs and return them."""
        jobs = [job for jobs in self._jobs.values() for job in jobs]
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
        """Return how long to wait for clients that are expected soon, s."""
        until = max(self._idle_since, min(job.arrived for job in batch)) + _MAX_WAIT_SHARE * self._model_s
        asking = {job.slot for job in batch}
        due = [
            min(timing.answered + _PAUSE_TOLERANCE * timing.pause, until)
            for slot, timing in self._client_timings.items()
            if slot not in asking and timing.answered and timing.pause and timing.answered + timing.pause <= until
        ]
        # A client whose request has arrived, and whose images are still being decoded.
        decoding = any(
            slot not in asking and not jobs[0].ready and any(job.method in _ACTIONS for job in jobs)
            for slot, jobs in self._jobs.items()
        )
        return max(0.0, *(time - now for time in (*due, until if decoding else now)))


def _mean(old: float, new: float) -> float:
    return (1.0 - _MEAN_WEIGHT) * old + _MEAN_WEIGHT * new
