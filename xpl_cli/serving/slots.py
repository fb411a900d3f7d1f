"""Who may use which worker, free of I/O: every connection has a place of its own, or is told to come back."""

from __future__ import annotations

import collections
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from xpl import _spec as spec
from xpl_cli.serving.requests import ReplayCache, RequestError

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable


@dataclass(eq=False)
class WorkerSlot:
    """A worker, or a range of environments in a shared one.

    Attributes:
        worker: number of the worker.
        client: number of the client within it.
        holder: the connection that has the place, or None.
        evaluation: evaluation_id of its client, kept for a while after a cut.
        session: the client's secret, if it has one.
        free_at: until when the place waits for that client, on the monotonic clock.
        tenancy: number of its client; another one means that the episode's state is gone.
        begun: its client's episode began here.
        stale: something of an earlier episode is still there.
        replay: answers to the client's requests.
        sequence: number of the next pipelined update.
    """

    worker: int
    client: int
    holder: Hashable | None = None
    evaluation: str | None = None
    session: str | None = None
    free_at: float = 0.0
    tenancy: int = 0
    begun: bool = False
    stale: bool = False
    replay: ReplayCache = field(default_factory=ReplayCache)
    sequence: int = 0


class SlotPool:
    """Gives places to connections.

    Args:
        workers: number of workers.
        clients: clients that may use one worker at the same time.
        grace: seconds that a place waits for a client whose connection was cut.
        clock: the time, in seconds.
    """

    def __init__(self, workers: int, clients: int, grace: float, clock: Callable[[], float] = time.monotonic) -> None:
        # By client first, so that clients spread over the workers.
        self._places = [WorkerSlot(worker, client) for client in range(clients) for worker in range(workers)]
        self._grace = grace
        self._clock = clock
        self._tenancies = 0
        self._held: dict[Hashable, WorkerSlot] = {}

    def __len__(self) -> int:
        return len(self._places)

    def taken(self) -> int:
        """Return how many places are in use, those that wait for their client included."""
        return sum(not self._is_free(place) for place in self._places)

    def of(self, connection: Hashable) -> WorkerSlot | None:
        """Return the place of a connection, if it has one."""
        return self._held.get(connection)

    def take(
        self, connection: Hashable, evaluation: str, session: str | None = None
    ) -> tuple[WorkerSlot, Hashable | None]:
        """Return a place for a connection, and the lost connection whose place it takes over, if any.

        A client comes back to its own place: by its secret even while the old connection seems alive, and by its
        evaluation_id once that is gone. Another client gets a new tenancy, and the place is marked as stale.

        Raises:
            RequestError: `busy` if there is none.
        """
        for place in self._places:
            known = place.evaluation == evaluation and place.session == session
            if known and (place.holder is None or session is not None):
                lost, place.holder = place.holder, connection
                self._held.pop(lost, None)
                self._held[connection] = place
                return place, lost
        free = [place for place in self._places if self._is_free(place)]
        if not free:
            raise RequestError(
                spec.ErrorCode.INTERNAL, "the policy server is in use by another client", spec.ErrorReason.BUSY
            )
        busy = collections.Counter(place.worker for place in self._places if not self._is_free(place))
        # Where the fewest others are, and there the one that was given away longest ago.
        place = min(free, key=lambda place: (busy[place.worker], place.tenancy))
        self._tenancies += 1
        place.holder, place.evaluation, place.session, place.tenancy = connection, evaluation, session, self._tenancies
        place.stale, place.begun, place.sequence = place.stale or place.begun, False, 0
        place.replay.forget()
        self._held[connection] = place
        return place, None

    def leave(self, connection: Hashable, *, clean: bool) -> WorkerSlot | None:
        """Take a place back and return it; after a cut its client has the grace period to come back."""
        place = self._held.pop(connection, None)
        if place is None:
            return None
        place.holder = None
        place.free_at = self._clock() + (0.0 if clean else self._grace)
        if clean:  # whoever comes back after a goodbye begins anew
            place.evaluation = place.session = None
        return place

    def close(self, worker: int) -> list[Hashable]:
        """Take all places of a worker away, and return the connections that had them."""
        lost = [place.holder for place in self._places if place.worker == worker and place.holder is not None]
        self._places = [place for place in self._places if place.worker != worker]
        for connection in lost:
            del self._held[connection]
        return lost

    def _is_free(self, place: WorkerSlot) -> bool:
        return place.holder is None and self._clock() >= place.free_at
