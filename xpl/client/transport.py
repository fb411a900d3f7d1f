"""What a client is built from: the connection that carries its messages, and what it wishes for."""

from __future__ import annotations

from collections.abc import Coroutine, Mapping
from dataclasses import dataclass, field
from typing import Any, Callable, Protocol, TypeVar

_Value = TypeVar("_Value")


class Transport(Protocol):
    """A WebSocket connection. A lost one is an OSError, a missed deadline a TimeoutError."""

    async def open(self, timeout: float | None) -> None:
        """Connect within `timeout` seconds."""

    async def send(self, data: bytes, timeout: float | None) -> None:
        """Send a binary message within `timeout` seconds."""

    async def receive(self, timeout: float | None) -> bytes:
        """Return the next binary message."""

    async def close(self) -> None:
        """Close the connection, if there is one."""

    async def pause(self, seconds: float) -> None:
        """Let time pass."""


@dataclass(frozen=True)
class Wishes:
    """What a client would like to have; what the server does not offer is done without.

    Attributes:
        packed: send payloads packed.
        shared_memory: share memory with a server on this host.
        pipelined: send updates without waiting for their answers; their errors are raised by what is asked next.
        jpeg: quality, 1..100, of the cameras whose colour is sent as JPEG; the others are lossless.
        environment: what the environment offers (`xpl.client.agreement`); the server refuses what does not fit.
        on_loading: told how far loading is while the model loads.
    """

    packed: bool = True
    shared_memory: bool = True
    pipelined: bool = False
    jpeg: Mapping[str, int] = field(default_factory=dict)
    environment: Mapping[str, Any] | None = None
    on_loading: Callable[[Mapping[str, Any]], None] | None = None


def run(talk: Coroutine[Any, Any, _Value]) -> _Value:
    """Run a conversation over a transport that blocks to its end: it is never suspended."""
    try:
        talk.send(None)
    except StopIteration as done:
        value: _Value = done.value
        return value
    raise AssertionError("a blocking transport was suspended")
