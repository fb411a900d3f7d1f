from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import pytest

from xpl.wire import codec
from xpl_cli.serving.slots import WorkerSlot
from xpl_cli.serving.workers.job_queue import JobQueue, RequestJob

READY = b"a packed map"


def job(slot: WorkerSlot, method: str = "get_action", ready: bool = True) -> RequestJob:
    """Return a job; one that is not ready has images to be decoded still."""
    return RequestJob(codec.Frame("call", "e"), method, slot, payload=READY if ready else None)


def slots(count: int) -> list[WorkerSlot]:
    """Return the slots of several clients of one worker."""
    return [WorkerSlot(0, client) for client in range(count)]


def taken(queue: JobQueue, now: float = 1.0) -> list[RequestJob]:
    jobs, wait = queue.next_batch(now)
    assert wait == 0.0
    return jobs


# -- a worker of one client --------------------------------------------------------------------------------------------


def test_requests_of_one_client_run_in_their_order() -> None:
    """Updates go together with the action that follows: one message to the worker instead of many."""
    queue, slot = JobQueue(), WorkerSlot(0, 0)
    methods = ["reset", "update_obs", "update_obs_batch", "get_action", "update_obs", "infer", "declared", "update_obs"]
    jobs = [job(slot, method) for method in methods]
    for one in jobs:
        queue.add(one, 1.0)
    runs = []
    while batch := taken(queue):
        runs.append(batch)
        queue.finished(batch, 1.0)
    assert [[one.method for one in batch] for batch in runs] == [
        ["reset"], ["update_obs", "update_obs_batch", "get_action"], ["update_obs", "infer"], ["declared"],
        ["update_obs"],
    ]  # fmt: skip
    assert list(itertools.chain(*runs)) == jobs
    assert len(queue) == 0
    assert not queue.has_jobs_of(slot)


def test_a_long_row_of_updates_is_cut() -> None:
    """So that a deadline is never that of a hundred requests."""
    queue, slot = JobQueue(), WorkerSlot(0, 0)
    for _ in range(40):
        queue.add(job(slot, "update_obs"), 1.0)
    assert [len(taken(queue)) for _ in range(4)] == [16, 16, 8, 0]


def test_a_request_whose_images_are_still_decoded_keeps_its_position() -> None:
    queue, slot = JobQueue(), WorkerSlot(0, 0)
    jobs = [job(slot, "update_obs"), job(slot, "update_obs", ready=False), job(slot)]
    for one in jobs:
        queue.add(one, 1.0)
    assert taken(queue) == jobs[:1]
    assert taken(queue) == []
    assert queue.has_jobs_of(slot)
    jobs[1].payload = READY
    assert taken(queue) == jobs[1:]


def test_a_new_client_comes_after_what_the_last_one_left() -> None:
    """A worker of one client has one row at a time."""
    queue = JobQueue()
    left, new = WorkerSlot(0, 0), WorkerSlot(0, 0)
    queue.add(job(left, "update_obs"), 1.0)
    queue.add(job(new), 1.0)
    queue.add(job(left), 1.0)
    assert [(one.slot, one.method) for one in taken(queue)] == [(left, "update_obs"), (left, "get_action")]
    assert [one.slot for one in taken(queue)] == [new]


def test_a_request_can_be_taken_out() -> None:
    """Once; what runs already is not in the queue any more."""
    queue, slot = JobQueue(), WorkerSlot(0, 0)
    first, second = job(slot), job(slot)
    queue.add(first, 1.0)
    queue.add(second, 1.0)
    queue.remove(first)
    queue.remove(first)
    assert len(queue) == 1
    assert taken(queue) == [second]
    queue.remove(second)
    assert not queue.has_jobs_of(slot)


def test_a_queue_can_be_emptied() -> None:
    """Its jobs are returned, to be answered by whoever does it."""
    queue = JobQueue(shared=True)
    jobs = [job(slot) for slot in slots(3)]
    for one in jobs:
        queue.add(one, 1.0)
    assert queue.clear() == jobs
    assert taken(queue) == []


def test_a_worker_is_sent_what_its_request_needs() -> None:
    assert RequestJob(codec.Frame("call", "e"), "get_action", WorkerSlot(2, 3), segment=7).request() == (
        3,
        "get_action",
        7,
        False,
    )
    assert RequestJob(codec.Frame("trial_end", "e"), "on_trial_end", WorkerSlot(2, 3)).request() == (
        3,
        "on_trial_end",
        None,
        True,
    )


# -- a worker of several clients ---------------------------------------------------------------------------------------


def test_clients_that_ask_at_once_run_as_one_batch() -> None:
    """One request of each, in the order in which they came; what only updates is done first."""
    queue = JobQueue(shared=True)
    first, second, third = slots(3)
    for slot, method in [
        (third, "get_action"), (first, "update_obs"), (first, "get_action"), (second, "infer"), (third, "get_action"),
    ]:  # fmt: skip
        queue.add(job(slot, method), 1.0 + len(queue))
    assert [(one.slot, one.method) for one in taken(queue, 9.0)] == [(first, "update_obs")]
    assert [one.slot for one in taken(queue, 9.0)] == [third, first, second]
    assert [one.slot for one in taken(queue, 9.0)] == [third]


def test_a_batch_is_no_larger_than_the_adapter_says() -> None:
    """Those who waited longest come first, and nobody waits for more."""
    queue = JobQueue(shared=True, max_batch=2)
    three = slots(3)
    for slot in reversed(three):
        queue.add(job(slot), 1.0)
    assert [one.slot for one in taken(queue)] == three[:0:-1]
    assert [one.slot for one in taken(queue)] == three[:1]


def test_clients_whose_images_are_decoded_hold_up_nobody_for_long() -> None:
    queue = JobQueue(shared=True)
    slow, quick = slots(2)
    late = job(slow, ready=False)
    for one in (late, job(slow, "reset"), job(quick)):
        queue.add(one, 1.0)
    assert [one.slot for one in taken(queue)] == [quick]
    assert taken(queue) == []
    late.payload = READY
    assert taken(queue) == [late]
    assert [one.method for one in taken(queue)] == ["reset"]


# -- who waits for whom: a clock of our own ----------------------------------------------------------------------------


@dataclass
class Clients:
    """Closed-loop clients of one shared model, on a clock that nobody has to wait for.

    Args:
        pauses: for each client, what it does between an answer and its next request, s.
        model: seconds that a batch of a size takes.
        max_batch: largest batch.
        decoding: seconds until a request is ready.
    """

    pauses: list[Callable[[], float]]
    model: Callable[[int], float] = lambda size: 0.020 + 0.001 * size
    max_batch: int | None = None
    decoding: float = 0.0
    batches: list[list[int]] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    now: float = 100.0

    def __post_init__(self) -> None:
        self.queue = JobQueue(shared=True, max_batch=self.max_batch)
        self.slots = slots(len(self.pauses))
        self.gone: set[int] = set()
        self._busy = False
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()

    def _later(self, delay: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.now + delay, next(self._count), action))

    def run(self, seconds: float, begin: Iterable[int] = ()) -> Clients:
        """Let time pass; clients that begin ask for the first time within 50 ms."""
        for client in begin:
            self._later(0.05 * client / len(self.slots), lambda client=client: self._ask(client))  # type: ignore[misc]
        end = self.now + seconds
        while self._events and self._events[0][0] <= end:
            self.now, _, action = heapq.heappop(self._events)
            action()
        self.now = end
        return self

    def _ask(self, client: int) -> None:
        if client in self.gone:
            return
        one = job(self.slots[client], "infer", ready=not self.decoding)
        self.queue.add(one, self.now)
        if self.decoding:
            self._later(self.decoding, lambda: self._decoded(one))
        self._pump()

    def _decoded(self, one: RequestJob) -> None:
        one.payload = READY
        self._pump()

    def _pump(self) -> None:
        if self._busy:
            return
        jobs, wait = self.queue.next_batch(self.now)
        if jobs:
            self._busy = True
            self.batches.append(sorted(one.slot.client for one in jobs))
            self._later(self.model(len(jobs)), lambda: self._done(jobs))
        elif wait:
            self.waits.append(wait)
            self._later(wait, self._pump)

    def _done(self, jobs: list[RequestJob]) -> None:
        self._busy = False
        self.queue.finished(jobs, self.now)
        for one in jobs:
            self.latencies.append(self.now - one.arrived)
            client = one.slot.client
            self._later(self.pauses[client](), lambda client=client: self._ask(client))  # type: ignore[misc]
        self._pump()

    def rate(self, seconds: float) -> float:
        """Return how many requests are answered per second."""
        before = len(self.latencies)
        return (len(self.run(seconds).latencies) - before) / seconds


def steady(pause: float, seed: int = 0) -> Callable[[], float]:
    """Return the pauses of a client that thinks for about as long every time."""
    numbers = random.Random(seed)  # noqa: S311 - a simulation
    return lambda: pause * numbers.uniform(0.8, 1.2)


def test_a_client_alone_never_waits() -> None:
    """Whatever its rhythm; nor do those who were alone before it."""
    for pause in (0.0, 0.001, 0.005, 0.1):
        clients = Clients([steady(pause)]).run(5.0, begin=[0])
        assert clients.waits == []
        assert max(clients.latencies) == pytest.approx(0.021)


# Together less than a quarter of the model's time: so long they are waited for.
@pytest.mark.parametrize(("pause", "decoding"), [(0.0005, 0), (0.002, 0), (0.004, 0), (0.0005, 0.003), (0.002, 0.003)])
def test_closed_loop_clients_converge_to_full_batches(pause: float, decoding: float) -> None:
    """Eight clients of a model that takes 20 ms and 1 ms for each: whoever comes first waits for the others.

    A round then takes 28 ms and what the clients need; two groups that take turns would get 167 requests per second.
    """
    clients = Clients([steady(pause, client) for client in range(8)], decoding=decoding).run(3.0, begin=range(8))
    clients.batches.clear()
    assert clients.rate(3.0) > 0.9 * 8 / (0.028 + pause + decoding)
    full = sum(len(batch) == 8 for batch in clients.batches)
    assert full >= 0.98 * len(clients.batches)


def test_waiting_costs_little_where_it_is_in_vain() -> None:
    """Clients of every rhythm, with a model that gains nothing by a batch: at most a quarter of its time is lost."""
    pauses = [0.001, 0.003, 0.007, 0.011, 0.02, 0.03, 0.05, 0.1]
    clients = Clients([steady(pause) for pause in pauses], model=lambda size: 0.004 * size).run(1.0, begin=range(8))
    longest = 0.25 * 0.004 * 8
    assert max(clients.waits, default=0.0) <= longest * (1 + 1e-9)
    assert max(clients.latencies) < 2 * 0.004 * 8 + longest


def test_a_client_that_went_away_is_not_waited_for() -> None:
    """Neither one that said goodbye, nor one that merely fell silent; the others are as quick as before."""
    clients = Clients([steady(0.002, client) for client in range(8)]).run(3.0, begin=range(8))
    clients.gone.add(3)
    clients.run(0.1)
    clients.waits.clear()
    clients.batches.clear()
    assert clients.rate(3.0) > 0.9 * 7 / (0.027 + 0.002)
    assert [0, 1, 2, 4, 5, 6, 7] in clients.batches
    clients.gone.add(5)
    clients.queue.forget(clients.slots[5])
    clients.run(0.1)
    clients.batches.clear()
    assert clients.rate(3.0) > 0.9 * 6 / (0.026 + 0.002)
    clients.gone.update(range(1, 8))
    clients.run(0.2)
    clients.waits.clear()
    clients.run(1.0)
    assert clients.waits == []


def test_a_client_that_comes_later_joins() -> None:
    """After a few rounds it belongs to the batch."""
    clients = Clients([steady(0.002, client) for client in range(8)]).run(2.0, begin=range(7))
    clients.run(2.0, begin=[7])
    assert clients.batches[-1] == list(range(8))


def test_full_batches_wait_for_nobody() -> None:
    """Where the adapter allows less than there are clients, everyone still gets a turn."""
    clients = Clients([steady(0.001, client) for client in range(8)], max_batch=4).run(5.0, begin=range(8))
    assert max(map(len, clients.batches)) == 4
    counts = [sum(client in batch for batch in clients.batches) for client in range(8)]
    assert max(counts) - min(counts) <= 0.1 * max(counts)
    assert max(clients.latencies) < 3 * 0.024
