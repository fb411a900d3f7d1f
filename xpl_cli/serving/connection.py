"""One WebSocket connection of the front end: whole messages in, answers out, and no more of either than fits."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import socket
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from picows import WSCloseCode, WSListener, WSMsgType

from xpl import _spec as spec
from xpl_cli.serving.entry.memory_limiter import ByteCountingProtocol
from xpl_cli.serving.server_log import RateLimitedLog

if TYPE_CHECKING:
    from collections.abc import Callable

    from picows import WSFrame, WSTransport

    from xpl.wire import codec
    from xpl.wire.segment import Segment
    from xpl_cli.serving.slots import WorkerSlot

_NORMAL = 1000
_CLEAN = (0, _NORMAL, 1001)
"""Codes of a goodbye; 0 is what the library calls a close frame without any (RFC 6455, section 7.1.5)."""
_REASON_BYTES = 123  # RFC 6455, section 5.5
_text_ignored = RateLimitedLog("ignored a text message: the wire is binary", most=10)
_DATA = (WSMsgType.BINARY, WSMsgType.TEXT, WSMsgType.CONTINUATION)


class ConnectionOwner(Protocol):
    """What a connection tells the front end."""

    def connected(self, connection: Connection) -> None:
        """Say that a connection was opened."""

    def received(self, connection: Connection, data: bytes | memoryview) -> None:
        """Pass on a binary message; the view is good for the length of the call only."""

    def asked(self, connection: Connection, frame: codec.Frame, size: int) -> None:
        """Pass on a request of so many bytes."""

    def holds(self, connection: Connection) -> None:
        """Say that a connection holds more or less memory than before."""

    def disconnected(self, connection: Connection, *, clean: bool) -> None:
        """Say that a connection is gone."""


@dataclass(frozen=True)
class ConnectionTimeouts:
    """Deadlines of a connection, s; None means none.

    Attributes:
        hello: longest silence at the beginning.
        ping_interval: time between two pings.
        ping_timeout: longest time that the peer's machine may leave what was sent unacknowledged, beyond that.
        close: longest wait for the other side to close.
    """

    hello: float | None
    ping_interval: float | None
    ping_timeout: float | None
    close: float | None


class Connection(WSListener):
    """A peer.

    Attributes:
        packs: it announced that it reads packed answers.
        counts: it announced that it numbers its requests.
        place: the place that it has, or had last.
        segment: memory shared with it.
        segment_number: what the workers call that memory, once the peer proved that it sees it.
    """

    def __init__(self, owner: ConnectionOwner, timing: ConnectionTimeouts) -> None:
        self._owner = owner
        self._timing = timing
        self._loop = asyncio.get_running_loop()
        self._transport: WSTransport | None = None
        self._incoming: ByteCountingProtocol | None = None
        self._message: bytearray | None = None
        self._fragments = 0
        self._is_text = False
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._pending: collections.deque[int] = collections.deque()
        self._pending_bytes = 0
        self._choked = False
        self._reading = True
        self._clean = False
        self._spoke = False
        self.is_open = False
        self.packs = False
        self.counts = False
        self.place: WorkerSlot | None = None
        self.segment: Segment | None = None
        self.segment_number: int | None = None

    # -- what the library calls ----------------------------------------------------------------------------------------

    def on_ws_connected(self, transport: WSTransport) -> None:
        """Set the deadlines."""
        self._transport = transport
        self.is_open = True
        raw = transport.underlying_transport
        self._incoming = ByteCountingProtocol(raw.get_protocol(), self._holds)  # type: ignore[arg-type]  # the library's is buffered
        raw.set_protocol(self._incoming)
        self._notice_dead_peer(transport)
        self._after("silence", self._timing.hello, self._no_hello)
        self._after("ping", self._timing.ping_interval, self._ping)
        self._owner.connected(self)

    def on_ws_frame(self, transport: WSTransport, frame: WSFrame) -> None:
        """Put fragments together, and pass on whole messages."""
        kind = frame.msg_type
        if self._incoming is not None:
            self._incoming.unread = 0
        if frame.rsv1 or frame.rsv2 or frame.rsv3:
            self.close(WSCloseCode.PROTOCOL_ERROR.value, "no extension was agreed on")
        elif kind == WSMsgType.BINARY and frame.fin and self._message is None:
            self._whole(frame.get_payload_as_memoryview())
        elif kind in _DATA:
            self._fragment(frame)
        elif kind == WSMsgType.CLOSE:
            code = int(frame.get_close_code())  # type: ignore[call-overload]
            self._clean = code in _CLEAN
            with contextlib.suppress(Exception):  # the peer may be gone before it hears us
                transport.send_close(code or _NORMAL)  # type: ignore[arg-type]  # any code will do
            transport.disconnect()

    def on_ws_disconnected(self, transport: WSTransport) -> None:  # noqa: ARG002 - the library's signature
        """Clear up."""
        self.is_open = False
        for timer in self._timers.values():
            timer.cancel()
        if self.segment is not None and self.segment_number is None:  # otherwise the worker is about to open it
            self.segment.close()
        self._owner.disconnected(self, clean=self._clean)

    def pause_writing(self) -> None:
        """Read nothing from a peer that does not read its answers."""
        self._choked = True
        self._regulate()

    def resume_writing(self) -> None:
        """Read on."""
        self._choked = False
        self._regulate()

    # -- what the front end calls --------------------------------------------------------------------------------------

    @property
    def is_local(self) -> bool:
        """Whether the peer speaks from a loopback address."""
        peer = self._raw("peername")
        address = str(peer[0]).removeprefix("::ffff:") if isinstance(peer, tuple) else ""
        return address.startswith("127.") or address == "::1"

    @property
    def is_silent(self) -> bool:
        """Whether it has not said anything yet."""
        return not self._spoke

    @property
    def descriptor(self) -> int:
        """Number of its socket; -1 if there is none."""
        raw = self._raw("socket")
        return -1 if raw is None else int(raw.fileno())

    @property
    def held(self) -> int:
        """Bytes of its messages: the room for one, what is put together of one, and those that are unanswered."""
        room = 0 if self._incoming is None else self._incoming.room
        return room + len(self._message or b"") + self._pending_bytes

    def cut(self) -> None:
        """End the connection at once, without a word."""
        if self._transport is not None:
            self._transport.underlying_transport.abort()

    def expect_answer(self, size: int) -> None:
        """Count a request of so many bytes; a peer that has too many unanswered is not read."""
        self._pending.append(size)
        self._pending_bytes += size
        self._holds()
        self._regulate()

    def answer(self, data: bytes) -> None:
        """Send the answer to a request, if the peer is still there."""
        self._settle()
        self.send(data)

    def send(self, data: bytes) -> None:
        """Send a message, if the peer is still there."""
        if self.is_open and self._transport is not None:
            self._transport.send(WSMsgType.BINARY, data)

    def close(self, code: int, reason: str = "") -> None:
        """Close in order; by force if the peer does not answer in time."""
        if not self.is_open or self._transport is None:
            return
        self._clean = self._clean or code in _CLEAN
        if not self._transport.is_close_frame_sent:
            short = reason.encode()[:_REASON_BYTES].decode(errors="ignore")
            self._transport.send_close(code, short)  # type: ignore[arg-type]  # any code will do
        self._after("closing", self._timing.close, self._transport.underlying_transport.abort)

    @property
    def is_busy(self) -> bool:
        """Whether requests of it are unanswered."""
        return bool(self._pending)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _fragment(self, frame: WSFrame) -> None:
        starts = frame.msg_type != WSMsgType.CONTINUATION
        if starts is (self._message is not None):
            self.close(WSCloseCode.PROTOCOL_ERROR.value, "fragments out of order")
            return
        if self._message is None:
            self._message, self._fragments, self._is_text = bytearray(), 0, frame.msg_type == WSMsgType.TEXT
        self._message += frame.get_payload_as_memoryview()
        self._fragments += 1
        self._holds()
        if len(self._message) > spec.LIMITS["frame_bytes"] or self._fragments > spec.LIMITS["fragments"]:
            self._message = None
            self.close(WSCloseCode.MESSAGE_TOO_BIG.value, "the message is over the limit")
        elif frame.fin:
            whole, self._message = bytes(self._message), None
            if self._is_text:
                self._text(whole)
            else:
                self._whole(whole)

    def _holds(self) -> None:
        if self.is_open:  # answers of one that is gone still come
            self._owner.holds(self)

    def _whole(self, data: bytes | memoryview) -> None:
        self._heard()
        self._owner.received(self, data)

    def _text(self, data: bytes) -> None:
        """Ignore a text message: xpl's wire is binary."""
        del data
        _text_ignored.note()

    def _heard(self) -> None:
        """Wait for a first word no longer: it came."""
        self._spoke = True
        self._wait_on()

    def _wait_on(self) -> None:
        """Wait for a first word as long as it takes."""
        hello = self._timers.pop("silence", None)
        if hello is not None:
            hello.cancel()

    def _settle(self) -> None:
        """Count a request as answered."""
        self._pending_bytes -= self._pending.popleft()
        self._holds()
        self._regulate()

    def _regulate(self) -> None:
        few = len(self._pending) < spec.LIMITS["pending"] and self._pending_bytes < spec.LIMITS["pending_bytes"]
        reading = few and not self._choked
        if reading == self._reading or not self.is_open or self._transport is None:
            return
        self._reading = reading
        raw = self._transport.underlying_transport
        if reading:
            raw.resume_reading()
        else:
            raw.pause_reading()

    def _no_hello(self) -> None:
        self.close(spec.CLOSE_CODES["no_hello"], f"nothing was said within {self._timing.hello:g} s")

    def _ping(self) -> None:
        if self.is_open and self._transport is not None:
            self._transport.send_ping()
            self._after("ping", self._timing.ping_interval, self._ping)

    def _after(self, name: str, seconds: float | None, action: Callable[[], None]) -> None:
        if seconds:
            self._timers[name] = self._loop.call_later(seconds, action)

    def _notice_dead_peer(self, transport: WSTransport) -> None:
        """Have the kernel cut the connection if the peer's machine no longer acknowledges what is sent, pings included.

        Not by a missing pong: clients in the field answer pings only while a call is under way.
        """
        interval, timeout = self._timing.ping_interval, self._timing.ping_timeout
        raw = transport.underlying_transport.get_extra_info("socket")
        if raw is not None and interval and timeout and hasattr(socket, "TCP_USER_TIMEOUT"):
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * (interval + timeout)))

    def _raw(self, name: str) -> Any:
        return None if self._transport is None else self._transport.underlying_transport.get_extra_info(name)
