"""Limit half-open connections, so that file descriptors remain for regular clients.

A connection takes a descriptor as soon as it is accepted, long before the first request. The limiter counts
connections without a WebSocket request, and drops the oldest when there are too many: a regular client sends its
request within milliseconds. Where descriptors run out nevertheless, a reserved one lets the server reject connections.
"""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import socket
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl_cli.serving.server_log import RateLimitedLog

if TYPE_CHECKING:
    from collections.abc import Callable

Accepted = tuple[socket.socket, Any]
"""A connection and the peer's address, in the form of its address family."""

HALF_OPEN = 64
"""Most connections that have not requested a WebSocket yet."""
_BACKLOG = 1024
_RESERVED = 64
"""Descriptors reserved for workers, logs and late imports."""
_PER_CONNECTION = 3
"""Descriptors per connection: its socket and its shared memory."""
_OUT = (errno.EMFILE, errno.ENFILE)
_NOT_HERE = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)


def connection_limits() -> tuple[int, int]:
    """Return the limits on connections and on half-open ones, by the descriptors of this process."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    left = max(16, (1 << 20 if soft == resource.RLIM_INFINITY else soft) - _RESERVED)
    half_open = min(HALF_OPEN, left // 8)
    return min(spec.LIMITS["connections"], (left - half_open) // _PER_CONNECTION), half_open


class ConnectionLimiter:
    """Accepts connections within the limits.

    Args:
        max_half_open: limit on half-open connections.
    """

    def __init__(self, max_half_open: int = HALF_OPEN) -> None:
        self._max_half_open = max_half_open
        self._half_open: dict[int, socket.socket] = {}
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
        self._dropped_log = RateLimitedLog("dropped a connection without a request: there are too many")
        self._rejected_log = RateLimitedLog("rejected a connection: this process has no descriptor left")

    def bind(self, host: str, port: int) -> list[socket.socket]:
        """Return sockets bound to every address of a host; with port 0 the system chooses one port for all.

        Raises:
            OSError: if there is no such address, or it cannot be bound.
        """
        addresses = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        bound: list[socket.socket] = []
        problem = OSError(errno.EADDRNOTAVAIL, f"{host!r} has no address")
        for family, kind, protocol, _, address in sorted(addresses, key=lambda entry: entry[0] != socket.AF_INET):
            chosen = bound[0].getsockname()[1] if bound else port
            try:
                bound.append(
                    _LimitedSocket.create_bound(self, (family, kind, protocol), (address[0], chosen, *address[2:]))
                )
            except OSError as error:
                problem = error
                # `localhost` may have an IPv6 address without IPv6, and a chosen port may be taken there.
                if error.errno not in _NOT_HERE and (port or not bound):
                    break
        else:
            if bound:
                return bound
        for made in bound:
            made.close()
        raise problem

    def note_upgrade(self, descriptor: int) -> None:
        """Count a connection as a WebSocket."""
        self._half_open.pop(descriptor, None)

    def close(self) -> None:
        """Close the reserved descriptor."""
        spare, self._spare = self._spare, -1
        if spare >= 0:
            os.close(spare)

    def accept_limited(self, accept: Callable[[], Accepted]) -> Accepted:
        """Accept a connection, and drop the oldest half-open one if there are too many.

        Raises:
            BlockingIOError: if there is none to accept, or no descriptor is left.
        """
        try:
            connection, address = accept()
        except OSError as error:
            if error.errno not in _OUT:
                raise
            self._reject(accept)
            raise BlockingIOError from None
        self._half_open.pop(connection.fileno(), None)  # of a closed connection
        self._half_open[connection.fileno()] = connection
        if len(self._half_open) > self._max_half_open:
            self._half_open = {number: one for number, one in self._half_open.items() if one.fileno() >= 0}
            while len(self._half_open) > self._max_half_open:
                self._drop_oldest()
        return connection, address

    def _drop_oldest(self) -> None:
        oldest = self._half_open.pop(next(iter(self._half_open)))
        self._dropped_log.log()
        with contextlib.suppress(OSError):
            oldest.shutdown(socket.SHUT_RDWR)  # its owner reads the end of the stream, and closes it

    def _reject(self, accept: Callable[[], Accepted]) -> None:
        """Accept and close a connection: one that stays in the queue would wake the server again and again."""
        self._rejected_log.log()
        if self._half_open:
            self._drop_oldest()
        self.close()
        with contextlib.suppress(OSError):
            accept()[0].close()
        with contextlib.suppress(OSError):
            self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)


class _LimitedSocket(socket.socket):
    """A listening socket that accepts through a connection limiter."""

    _limiter: ConnectionLimiter

    @classmethod
    def create_bound(cls, limiter: ConnectionLimiter, kind: tuple[int, int, int], address: Any) -> _LimitedSocket:
        """Return a socket of a family, type and protocol that is bound to an address."""
        made = cls(*kind)
        made._limiter = limiter
        try:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if made.family == socket.AF_INET6:
                made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            made.bind(address)
        except OSError:
            made.close()
            raise
        return made

    def listen(self, _backlog: int = _BACKLOG, /) -> None:
        """Listen with a queue that is long enough for bursts."""
        super().listen(_BACKLOG)

    def accept(self) -> Accepted:
        """Accept through the limiter."""
        return self._limiter.accept_limited(super().accept)
