"""Memory that messages take: of all connections together, since many small claims fill a machine as a large one does.

What has arrived of a message lies in a buffer of the WebSocket library, which says nothing of it before the message is
whole, and keeps its room for the next one. So the bytes are counted where they come in.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Protocol

from xpl import _spec as spec
from xpl_cli.serving.server_log import RateLimitedLog

if TYPE_CHECKING:
    from collections.abc import Callable

_TRY_AGAIN = 1013  # registered in the WebSocket close code registry
_STEP = 1 << 18


class ByteCountingProtocol(asyncio.BufferedProtocol):
    """Stands between a connection and the library that reads it, and counts what came since the last whole message.

    Args:
        protocol: the library's.
        on_growth: told when `room` has grown.

    Attributes:
        unread: these bytes.
        room: most that they have been, in steps: what the library's buffer takes.
    """

    def __init__(self, protocol: asyncio.BufferedProtocol, on_growth: Callable[[], None]) -> None:
        self._protocol = protocol
        self._on_growth = on_growth
        self.unread = self.buffer_bytes = 0

    def get_buffer(self, sizehint: int) -> Any:
        """Return where to put what comes."""
        return self._protocol.get_buffer(sizehint)

    def buffer_updated(self, nbytes: int) -> None:
        """Count so many bytes, and pass them on."""
        self.unread += nbytes
        if self.unread >= self.buffer_bytes + _STEP:
            self.buffer_bytes = self.unread
            self._on_growth()
        self._protocol.buffer_updated(nbytes)

    def eof_received(self) -> bool | None:
        """Pass on that no more will come."""
        return self._protocol.eof_received()

    def pause_writing(self) -> None:
        """Pass on that the peer does not read."""
        self._protocol.pause_writing()

    def resume_writing(self) -> None:
        """Pass on that it reads on."""
        self._protocol.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass on that it is gone, and let go of the library's buffer at once."""
        protocol, self._protocol = self._protocol, asyncio.BufferedProtocol()
        protocol.connection_lost(exc)


class ByteBudget:
    """Who holds how many bytes, within a sum.

    Args:
        most: bytes that all may hold together.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._bytes_by_holder: dict[MemoryHolder, int] = {}
        self._sum = 0

    def set(self, holder: MemoryHolder, size: int) -> MemoryHolder | None:
        """Note that somebody holds so many bytes now; return who has to go: the one with most, where it is too much."""
        self._sum += size - self._bytes_by_holder.get(holder, 0)
        self._bytes_by_holder[holder] = size
        return None if self._sum <= self._limit else max(self._bytes_by_holder, key=self._bytes_by_holder.__getitem__)

    def forget(self, holder: MemoryHolder) -> None:
        """Note that somebody holds nothing any more."""
        self._sum -= self._bytes_by_holder.pop(holder, 0)


class MemoryHolder(Protocol):
    """A connection that holds memory.

    Attributes:
        place: the place that it has, or None.
    """

    slot: Any

    @property
    def buffered_bytes(self) -> int:
        """Bytes that it holds."""

    def close(self, code: int, reason: str = "") -> None:
        """Close it in order."""

    def abort(self) -> None:
        """End it at once."""


class MessageMemoryLimiter:
    """All connections: where their messages take too much memory, the one with most of it is closed.

    Args:
        most: bytes that all may hold together.
        early: of these, bytes of connections that have no place yet.
    """

    def __init__(
        self, limit: int = spec.LIMITS["held_bytes"], unassigned_limit: int = spec.LIMITS["early_bytes"]
    ) -> None:
        self._all, self._unassigned = ByteBudget(limit), ByteBudget(unassigned_limit)
        self._closed = RateLimitedLog(
            "closed a connection: the messages of all took too much memory, and its own most of it"
        )

    def update(self, connection: MemoryHolder) -> None:
        """Note what a connection holds now."""
        size = connection.buffered_bytes
        largest = self._all.set(connection, size)
        if connection.slot is None:
            largest = self._unassigned.set(connection, size) or largest
        else:
            self._unassigned.forget(connection)
        if largest is not None:
            self._closed.log()
            largest.close(_TRY_AGAIN, "the messages of all connections take too much memory")
            largest.abort()
            self.forget(largest)

    def forget(self, connection: MemoryHolder) -> None:
        """Note that a connection is gone."""
        self._all.forget(connection)
        self._unassigned.forget(connection)
