"""The two ends of every contender: a server of one model, and a connection to it.

A module here offers `serve(model, setting, ready)`, which calls `ready(address)` once and then serves forever, and
`async connect(address, setting)`, which returns a `Connection`. It is imported in the contender's own environment.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from benchmarks.serving_bench.payloads import Payload

Ready = Callable[[str], None]
"""Receives the address of a server."""

Ask = Callable[[], Awaitable[Any]]
"""Sends one request and returns its answer once that is there and decoded."""


class Connection(Protocol):
    """A client that is connected."""

    def asking(self, payload: Payload) -> Ask:
        """Return a function that requests the actions of this payload; it encodes anew each time."""

    async def close(self) -> None:
        """Close the connection."""
