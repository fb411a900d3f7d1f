"""Where connections come in: never so many at once that none is left for who is honest.

A connection costs a descriptor from the moment it is accepted, long before anything is said. Those that have not yet
asked for a WebSocket are therefore counted, and the oldest of them goes when there are too many: who is honest asks
within milliseconds. Where descriptors run out all the same, one that is kept for this turns connections away.
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
"""A connection, and the address at its other end in the form of its family."""

HALF_OPEN = 64
"""Connections that have not asked for a WebSocket yet, at most."""
_BACKLOG = 1024
_RESERVED = 64
"""Descriptors for all else: workers, logs, modules that are loaded late."""
_PER_CONNECTION = 3
"""Descriptors of a connection: its socket, and the memory that it shares."""
_OUT = (errno.EMFILE, errno.ENFILE)
_NOT_HERE = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)


def connection_limits() -> tuple[int, int]:
    """Return how many connections there may be, and how many half open ones, with the descriptors of this process."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    left = max(16, (1 << 20 if soft == resource.RLIM_INFINITY else soft) - _RESERVED)
    half_open = min(HALF_OPEN, left // 8)
    return min(spec.LIMITS["connections"], (left - half_open) // _PER_CONNECTION), half_open


class ConnectionLimiter:
    """Lets connections in.

    Args:
        most: connections that may be half open.
    """

    def __init__(self, max_half_open: int = HALF_OPEN) -> None:
        self._max_half_open = max_half_open
        self._half_open: dict[int, socket.socket] = {}
        self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
        self._dropped_log = RateLimitedLog(
            "dropped a connection that asked for nothing: there are more than can be kept"
        )
        self._rejected_log = RateLimitedLog("turned a connection away: this process has no descriptor left")

    def bind(self, host: str, port: int) -> list[socket.socket]:
        """Return sockets bound to every address of a host; port 0 lets the system choose one, the same for all.

        Raises:
            OSError: if there is no such address, or it cannot be had.
        """
        found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        bound: list[socket.socket] = []
        problem = OSError(errno.EADDRNOTAVAIL, f"{host!r} has no address")
        for family, kind, protocol, _, address in sorted(found, key=lambda one: one[0] != socket.AF_INET):
            chosen = bound[0].getsockname()[1] if bound else port
            try:
                bound.append(
                    _LimitedSocket.create_bound(self, (family, kind, protocol), (address[0], chosen, *address[2:]))
                )
            except OSError as error:
                problem = error
                # A machine without IPv6 still has a name for it, and a port that was chosen may be taken there.
                if error.errno not in _NOT_HERE and (port or not bound):
                    break
        else:
            if bound:
                return bound
        for made in bound:
            made.close()
        raise problem

    def note_upgrade(self, descriptor: int) -> None:
        """Say that a connection asked for a WebSocket, and got it."""
        self._half_open.pop(descriptor, None)

    def close(self) -> None:
        """Give back the descriptor that was kept."""
        spare, self._spare = self._spare, -1
        if spare >= 0:
            os.close(spare)

    def accept_limited(self, accept: Callable[[], Accepted]) -> Accepted:
        """Accept a connection, and drop the oldest that asked for nothing if there are too many.

        Raises:
            BlockingIOError: if there is none to accept, or none could be kept.
        """
        try:
            connection, address = accept()
        except OSError as error:
            if error.errno not in _OUT:
                raise
            self._reject(accept)
            raise BlockingIOError from None
        self._half_open.pop(connection.fileno(), None)  # of a connection that is gone
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
        """Take a connection off the queue and end it: one that stayed there would wake the server again and again."""
        self._rejected_log.log()
        if self._half_open:
            self._drop_oldest()
        self.close()
        with contextlib.suppress(OSError):
            accept()[0].close()
        with contextlib.suppress(OSError):
            self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)


class _LimitedSocket(socket.socket):
    """A socket that lets connections in through a door."""

    _limiter: ConnectionLimiter

    @classmethod
    def create_bound(cls, door: ConnectionLimiter, kind: tuple[int, int, int], address: Any) -> _LimitedSocket:
        """Return a socket of a family, type and protocol that is bound to an address."""
        made = cls(*kind)
        made._limiter = door
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
        """Listen with a queue that a burst does not fill."""
        super().listen(_BACKLOG)

    def accept(self) -> Accepted:
        """Accept through the door."""
        return self._limiter.accept_limited(super().accept)
