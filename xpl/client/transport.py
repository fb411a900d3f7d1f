"""What a client is built from: the connection that carries its messages, and what it wishes for."""

from __future__ import annotations

from collections.abc import Coroutine, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Callable, Protocol, TypeVar

if TYPE_CHECKING:
    import ssl

    from xpl.client.labels import Labels
    from xpl.contract import Announcement, Config

_Value = TypeVar("_Value")


class Transport(Protocol):
    """A WebSocket connection. A lost one is an OSError, a missed deadline a TimeoutError."""

    async def open(self, timeout: float | None) -> None:
        """Connect within `timeout` seconds."""

    async def send(self, data: bytes | str, timeout: float | None) -> None:
        """Send a message, binary or text, within `timeout` seconds."""

    async def receive(self, timeout: float | None) -> bytes:
        """Return the next binary message; text is dropped."""

    async def receive_any(self, timeout: float | None) -> bytes | str:
        """Return the next message, binary or text."""

    async def close(self) -> None:
        """Close the connection, if there is one."""

    async def pause(self, seconds: float) -> None:
        """Let time pass."""


@dataclass(frozen=True)
class Address:
    """Where a connection goes, and how it is let in.

    Attributes:
        url: `ws://host:port`, or `wss://`.
        config: the timing keys of deploy.yml.
        authorization: what the header `Authorization` says, or None.
        ssl_context: for `wss://`; the system's certificates otherwise.
    """

    url: str
    config: Config
    authorization: str | None
    ssl_context: ssl.SSLContext | None


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
    environment: Announcement | None = None
    on_loading: Callable[[Mapping[str, Any]], None] | None = None


@dataclass(frozen=True)
class Setup:
    """What a wire makes the client's side of a conversation of.

    Attributes:
        wire: the wire's name.
        address: `ws://host:port`, or `wss://`.
        config: values of deploy.yml, with the defaults of the timing keys.
        labels: what the evaluation calls itself.
        wishes: see there.
        transport: returns a connection to the address that is not yet open; blocking or suspending, as the client is.
    """

    wire: str
    address: str
    config: Config
    labels: Labels
    wishes: Wishes
    transport: Callable[[], Transport]


def run(talk: Coroutine[Any, Any, _Value]) -> _Value:
    """Run a conversation over a transport that blocks to its end: it is never suspended."""
    try:
        talk.send(None)
    except StopIteration as done:
        value: _Value = done.value
        return value
    raise AssertionError("a blocking transport was suspended")
