"""A blocking WebSocket connection over the sans-I/O protocol of `websockets` (>= 12).

The calling thread reads the socket itself: handing an answer over from a reader thread would cost as much as its way
over the network. A background thread serves the connection while it is idle: it answers pings and sends some, so that a
simulator that computes for minutes keeps its connection.
"""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import threading
import time
import weakref
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NoReturn

from xpl import _spec as spec
from xpl.client import wires
from xpl.client.errors import ServerConnectionError, ServerFailedError

if TYPE_CHECKING:
    from xpl.client.transport import ServerEndpoint

_CHUNK = 1 << 18
_NO_TOKEN, _REFUSED = 401, 403
_LOOK_S = 0.5
"""Interval at which an idle connection is served, s."""


class BlockingTransport:
    """A connection to one address.

    Args:
        endpoint: address and credentials.
        turn: lock of the thread that uses the connection.
    """

    def __init__(self, endpoint: ServerEndpoint, turn: threading.Lock) -> None:
        self._endpoint = endpoint
        self._turn = turn
        self._ping_interval = endpoint.config[spec.Deploy.WS_PING_INTERVAL_S]
        self._socket: socket.socket | None = None
        self._protocol: Any = None
        self._messages: list[bytes | str] = []
        self._fragments = bytearray()
        self._is_text = False
        self._open = False
        self._ended = False
        self._last_ping = 0.0

    async def open(self, timeout: float | None) -> None:
        """Connect within `timeout` seconds."""
        from websockets.client import ClientProtocol

        deadline, uri = _after(timeout), parse_url(self._endpoint.url)
        try:
            raw = socket.create_connection((uri.host, uri.port), _left(deadline))
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket = raw
            if uri.secure:
                context = self._endpoint.ssl_context or ssl.create_default_context()
                self._socket = context.wrap_socket(raw, server_hostname=uri.host)
            self._open, self._ended, self._messages, self._fragments = False, False, [], bytearray()
            self._protocol = ClientProtocol(uri, max_size=spec.LIMITS["frame_bytes"])
            request = self._protocol.connect()
            if self._endpoint.authorization is not None:
                request.headers["Authorization"] = self._endpoint.authorization
            self._protocol.send_request(request)
            self._flush()
            while self._protocol.state.name == "CONNECTING" and self._protocol.handshake_exc is None:
                self._read(deadline)
            # The answer to the handshake; the server's first message may have come with it.
            self._take(event for event in self._protocol.events_received() if hasattr(event, "opcode"))
        except ssl.SSLError as error:
            await self.close()
            raise ServerConnectionError(f"no secure connection to {self._endpoint.url}: {error}") from None
        except BaseException:
            await self.close()
            raise
        if self._protocol.handshake_exc is not None:
            problem = handshake_error(self._protocol.handshake_exc, self._endpoint.url)
            await self.close()
            raise problem
        self._open, self._last_ping = True, time.monotonic()
        # A daemon: it must not keep the interpreter alive for a script that forgets to close.
        threading.Thread(target=_keep_alive, args=(weakref.ref(self), self._socket), daemon=True).start()

    async def send(self, data: bytes | str, timeout: float | None) -> None:
        """Send a message, binary or text, within `timeout` seconds."""
        from websockets.exceptions import WebSocketException

        connected = self._connected()
        connected.settimeout(timeout)
        if self._ended:  # while the connection was idle
            self._end()
        try:
            if isinstance(data, str):
                self._protocol.send_text(data.encode())
            else:
                self._protocol.send_binary(data)
        except WebSocketException:  # the server closed right after the handshake, or broke the protocol
            self._end()
        self._flush()

    async def receive(self, timeout: float | None) -> bytes:
        """Return the next binary message; xpl's wire has no text messages."""
        deadline = _after(timeout)
        while True:
            message = self._next(deadline)
            if not isinstance(message, str):
                return message

    async def receive_any(self, timeout: float | None) -> bytes | str:
        """Return the next message, binary or text."""
        return self._next(_after(timeout))

    async def close(self) -> None:
        """Close the connection, if there is one, without waiting for the server."""
        connected, self._socket = self._socket, None
        if connected is None:
            return
        with contextlib.suppress(Exception):  # the server may be gone already
            connected.settimeout(0.0)
            self._protocol.send_close(1000)
            for data in self._protocol.data_to_send():
                connected.send(data)
        connected.close()

    async def pause(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)  # noqa: ASYNC251 - this transport is the one that blocks

    def service_idle(self) -> None:
        """Answer the pings received, and send one if it is due; for an idle connection."""
        connected = self._connected()
        if self._ping_interval and time.monotonic() - self._last_ping > self._ping_interval:
            self._last_ping = time.monotonic()
            self._protocol.send_ping(os.urandom(4))
        # One read per call: a server that never stops sending must neither hold the lock nor fill the memory.
        connected.settimeout(0.0)
        with contextlib.suppress(BlockingIOError, ssl.SSLWantReadError):
            if len(self._messages) < spec.LIMITS["pipelined"]:
                self._feed(connected.recv(_CHUNK))
        connected.settimeout(_LOOK_S)
        self._flush()

    def is_at(self, connected: socket.socket) -> bool:
        """Return whether this transport still uses the socket `connected`."""
        return self._socket is connected

    def try_acquire(self) -> bool:
        """Acquire the lock if it is free; `release` releases it."""
        return self._turn.acquire(blocking=False)

    def release(self) -> None:
        """Release the lock."""
        self._turn.release()

    def _connected(self) -> socket.socket:
        if self._socket is None:
            raise ConnectionResetError("the connection is closed")
        return self._socket

    def _flush(self) -> None:
        connected = self._connected()
        for data in self._protocol.data_to_send():
            if data:
                connected.sendall(data)

    def _next(self, deadline: float | None) -> bytes | str:
        while not self._messages:
            if self._ended:
                self._end()
            self._read(deadline)
        return self._messages.pop(0)

    def _read(self, deadline: float | None) -> None:
        connected = self._connected()
        connected.settimeout(_left(deadline))
        try:
            data = connected.recv(_CHUNK)
        except socket.timeout:
            raise TimeoutError("no answer in time") from None
        self._feed(data)
        with contextlib.suppress(OSError):  # a pong, or a farewell: what was received counts all the same
            connected.settimeout(_left(deadline))
            self._flush()

    def _feed(self, data: bytes) -> None:
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        if self._open:
            self._take(self._protocol.events_received())
        self._ended = self._ended or not data or self._protocol.parser_exc is not None

    def _take(self, frames: Iterable[Any]) -> None:
        from websockets.frames import Opcode

        for frame in frames:
            if frame.opcode is Opcode.CLOSE:
                self._ended = True
            elif frame.opcode in (Opcode.BINARY, Opcode.TEXT, Opcode.CONT):
                if frame.opcode is not Opcode.CONT:
                    self._is_text = frame.opcode is Opcode.TEXT
                if frame.fin and frame.opcode is not Opcode.CONT:  # the usual one, not copied
                    self._take_message(frame.data)
                    continue
                self._fragments += frame.data
                if frame.fin:
                    self._take_message(bytes(self._fragments))
                    self._fragments = bytearray()

    def _take_message(self, whole: bytes) -> None:
        self._messages.append(bytes(whole).decode(errors="replace") if self._is_text else whole)

    def _end(self) -> NoReturn:
        raise closed_error(self._protocol.close_rcvd)


def closed_error(received: Any) -> Exception:
    """Return the error of a closed connection by its close frame: the server's reason, or that it was lost."""
    if received is None:
        return ConnectionResetError("no close frame")
    reason = " ".join(received.reason.split())
    if received.code == spec.CLOSE_CODES["server_failed"]:
        return ServerFailedError(f"the policy server ended: {reason}")
    return ConnectionResetError(f"{received.code} {reason}")


def parse_url(url: str) -> Any:
    """Return the parts of an address.

    Raises:
        ServerConnectionError: it is no address.
    """
    from websockets.exceptions import InvalidURI
    from websockets.uri import parse_uri

    try:
        return parse_uri(url)
    except (InvalidURI, ValueError) as error:  # ValueError: an IPv6 address without an end, a port that is no number
        raise ServerConnectionError(f"a policy server's address is ws://host:port, got {url!r}: {error}") from None


def handshake_error(error: Exception, url: str) -> Exception:
    """Return the error of a refused handshake: final, or an OSError after which connecting is tried again."""
    response = getattr(error, "response", None)
    status = getattr(response, "status_code", None) or getattr(error, "status_code", None)
    if status == _NO_TOKEN:
        return ServerConnectionError(f"the policy server at {url} requires another bearer token (HTTP {status})")
    if status == _REFUSED:
        body = bytes(getattr(response, "body", None) or b"").decode(errors="replace").strip()
        return ServerConnectionError(f"the policy server at {url} refuses this client (HTTP {status}): {body:.300}")
    return ConnectionError(f"{error}; {wires.supported_wires()}")  # another kind of server


def _after(timeout: float | None) -> float | None:
    return None if timeout is None else time.monotonic() + timeout


def _left(deadline: float | None) -> float | None:
    """Return the seconds until a deadline, None without one.

    Raises:
        TimeoutError: the deadline has passed.
    """
    if deadline is None:
        return None
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeoutError("no answer in time")
    return left


def _keep_alive(reference: weakref.ref[BlockingTransport], connected: socket.socket) -> None:
    """Serve an idle connection at intervals, until it is closed or garbage-collected."""
    while True:
        time.sleep(_LOOK_S)
        transport = reference()
        if transport is None or not transport.is_at(connected):
            return
        if transport.try_acquire():  # otherwise a caller is reading, which answers pings as well
            try:
                transport.service_idle()
            except Exception:  # noqa: BLE001 - lost; the next operation raises it
                return
            finally:
                transport.release()
        del transport
