"""What a server may do to a client: it ends in an error of ours, whatever comes."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import socket
import struct
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from websockets.sync.server import ServerConnection, serve

from tests.support.peer import DEADLINE_S
from xpl import Client
from xpl.client import AsyncClient, ClientError
from xpl.wire import codec

ONCE: dict[str, Any] = {"max_connect_attempts": 1, "connect_timeout_s": DEADLINE_S, "handshake_timeout_s": DEADLINE_S}
FAREWELLS = {
    "a close at once": b"\x88\x02\x03\xe8",
    "a failure at once": b"\x88\x06" + struct.pack("!H", 4011) + b"gone",
    "an empty close": b"\x88\x00",
    "a bad frame": b"\xff\xff",
    "an end": b"",
}


@contextlib.contextmanager
def rude_server(farewell: bytes, without_end: bytes = b"") -> Iterator[str]:
    """Accept one WebSocket, say a last word at once with the handshake, and something without end."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(DEADLINE_S)

        def answer() -> None:
            connection, _ = listening.accept()
            with connection:
                connection.settimeout(DEADLINE_S)
                head = b""
                while not head.endswith(b"\r\n\r\n"):
                    head += connection.recv(4096)
                key = next(line for line in head.split(b"\r\n") if line.lower().startswith(b"sec-websocket-key"))
                digest = hashlib.sha1(key.split()[1] + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest()  # noqa: S324
                lines = [b"HTTP/1.1 101 X", b"Upgrade: websocket", b"Connection: Upgrade"]
                lines += [b"Sec-WebSocket-Accept: " + base64.b64encode(digest), b"", b""]
                connection.sendall(b"\r\n".join(lines) + farewell)
                with contextlib.suppress(OSError):
                    while without_end:
                        connection.sendall(without_end)
                    connection.shutdown(socket.SHUT_WR)
                    while connection.recv(4096):
                        pass

        thread = threading.Thread(target=answer)
        thread.start()
        yield f"ws://127.0.0.1:{listening.getsockname()[1]}"
        thread.join()


@pytest.mark.parametrize("farewell", FAREWELLS.values(), ids=FAREWELLS)
def test_a_server_that_closes_after_the_handshake_is_an_error_of_ours(farewell: bytes) -> None:
    with rude_server(farewell) as url, pytest.raises(ClientError):
        Client(url, config=ONCE)
    with rude_server(farewell) as url, pytest.raises(ClientError):
        asyncio.run(AsyncClient(url, config=ONCE).connect())


ENDLESS = {
    "fragments of one message": (b"\x02\x01a", b"\x00\x01a" * 4000),
    "empty fragments": (b"\x02\x00", b"\x00\x00" * 4000),
    "pings whose pongs nobody reads": (b"", (b"\x89\x64" + b"p" * 100) * 100),
    "text": (b"", (b"\x81\x64" + b"t" * 100) * 100),
}


@pytest.mark.parametrize(("first", "then"), ENDLESS.values(), ids=ENDLESS)
def test_a_deadline_holds_whatever_arrives(first: bytes, then: bytes) -> None:
    impatient = {**ONCE, "handshake_timeout_s": 0.5}
    with rude_server(first, then) as url, pytest.raises(ClientError, match="was not answered within"):
        Client(url, config=impatient)
    with rude_server(first, then) as url, pytest.raises(ClientError, match="was not answered within"):
        asyncio.run(AsyncClient(url, config=impatient).connect())


def test_what_a_server_says_last_steers_no_terminal() -> None:
    farewell = struct.pack("!H", 4011) + b"\x1b[31mred\n::error::x"
    with rude_server(b"\x88" + bytes([len(farewell)]) + farewell) as url, pytest.raises(ClientError) as raised:
        Client(url, config=ONCE)
    assert r"\x1b[31mred ::error::x" in str(raised.value)
    assert str(raised.value).isprintable()


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ({"code": ["x"]}, "the code of an error must be text, got list"),
        ({"code": "internal", "details": {"reason": {}}}, "the reason of an error must be text, got dict"),
        ({"code": "of another generation", "message": "\x1b[31m" * 10**6, "details": "abc"}, "internal: .x1b.31m"),
    ],
)
def test_an_error_of_another_form_is_one_of_ours(told: dict[str, Any], expected: str) -> None:
    def answered(connection: ServerConnection) -> None:
        for data in connection:
            asked = codec.decode(data if isinstance(data, bytes) else data.encode())
            connection.send(codec.encode(asked.answer("error", told)))

    with serve(answered, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        with pytest.raises(ClientError, match=expected) as raised:
            Client(f"ws://127.0.0.1:{server.socket.getsockname()[1]}", config=ONCE)
        server.shutdown()
        thread.join()
    assert len(str(raised.value)) < 10**6


@pytest.mark.parametrize("url", ["ws://[::1", "ws://h:port", "ws://h:99999", "http://h:1", "ws://", "nothing"])
def test_an_address_that_is_none_is_an_error_of_ours(url: str) -> None:
    with pytest.raises(ClientError, match="address is ws://host:port"):
        Client(url, config=ONCE)
    with pytest.raises(ClientError, match="address is ws://host:port"):
        asyncio.run(AsyncClient(url, config=ONCE).connect())
