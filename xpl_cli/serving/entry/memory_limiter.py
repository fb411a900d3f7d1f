"""Limit the memory of the messages of all connections together.

The WebSocket library buffers an incomplete message without reporting its size, and keeps the buffer for the next one.
So the bytes are counted as they arrive.
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
    """Protocol between a transport and the library: counts the bytes since the last complete message.

    Args:
        protocol: the library's.
        on_growth: called when `buffer_bytes` has grown.

    Attributes:
        unread: bytes since the last complete message.
        buffer_bytes: their maximum, in steps: the size of the library's buffer.
    """

    def __init__(self, protocol: asyncio.BufferedProtocol, on_growth: Callable[[], None]) -> None:
        self._protocol = protocol
        self._on_growth = on_growth
        self.unread = self.buffer_bytes = 0

    def get_buffer(self, sizehint: int) -> Any:
        """Return the library's buffer."""
        return self._protocol.get_buffer(sizehint)

    def buffer_updated(self, nbytes: int) -> None:
        """Count received bytes, and pass them on."""
        self.unread += nbytes
        if self.unread >= self.buffer_bytes + _STEP:
            self.buffer_bytes = self.unread
            self._on_growth()
        self._protocol.buffer_updated(nbytes)

    def eof_received(self) -> bool | None:
        """Pass on the end of the stream."""
        return self._protocol.eof_received()

    def pause_writing(self) -> None:
        """Pass on that the write buffer is full."""
        self._protocol.pause_writing()

    def resume_writing(self) -> None:
        """Pass on that the write buffer has drained."""
        self._protocol.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass on the end of the connection, and free the library's buffer at once."""
        protocol, self._protocol = self._protocol, asyncio.BufferedProtocol()
        protocol.connection_lost(exc)


class ByteBudget:
    """Bytes of each holder, within a total limit.

    Args:
        limit: bytes of all holders together.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._bytes_by_holder: dict[MemoryHolder, int] = {}
        self._sum = 0

    def set(self, holder: MemoryHolder, size: int) -> MemoryHolder | None:
        """Set the bytes of a holder; return the largest holder if the total exceeds the limit, else None."""
        self._sum += size - self._bytes_by_holder.get(holder, 0)
        self._bytes_by_holder[holder] = size
        return None if self._sum <= self._limit else max(self._bytes_by_holder, key=self._bytes_by_holder.__getitem__)

    def forget(self, holder: MemoryHolder) -> None:
        """Remove a holder."""
        self._sum -= self._bytes_by_holder.pop(holder, 0)


class MemoryHolder(Protocol):
    """A connection that holds memory.

    Attributes:
        slot: the client's slot, or None.
    """

    slot: Any

    @property
    def buffered_bytes(self) -> int:
        """Bytes of its buffered messages."""

    def close(self, code: int, reason: str = "") -> None:
        """Close it in order."""

    def abort(self) -> None:
        """Close it at once."""


class MessageMemoryLimiter:
    """Closes the connection with the most memory where the messages of all take too much.

    Args:
        limit: bytes of all connections together.
        unassigned_limit: bytes of all connections without a slot.
    """

    def __init__(
        self, limit: int = spec.LIMITS["held_bytes"], unassigned_limit: int = spec.LIMITS["early_bytes"]
    ) -> None:
        self._all, self._unassigned = ByteBudget(limit), ByteBudget(unassigned_limit)
        self._closed = RateLimitedLog(
            "closed the connection with the largest messages: those of all connections took too much memory"
        )

    def update(self, connection: MemoryHolder) -> None:
        """Update the memory of a connection."""
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
        """Remove a closed connection."""
        self._all.forget(connection)
        self._unassigned.forget(connection)
