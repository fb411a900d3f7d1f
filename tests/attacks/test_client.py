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

from tests.support.peer import DEADLINE_S
from xpl import Client
from xpl.client import AsyncClient, ClientError

ONCE: dict[str, Any] = {"max_connect_attempts": 1, "connect_timeout_s": DEADLINE_S, "handshake_timeout_s": DEADLINE_S}
FAREWELLS = {
    "a close at once": b"\x88\x02\x03\xe8",
    "a failure at once": b"\x88\x06" + struct.pack("!H", 4011) + b"gone",
    "an empty close": b"\x88\x00",
    "a bad frame": b"\xff\xff",
    "an end": b"",
}


@contextlib.contextmanager
def rude_server(farewell: bytes) -> Iterator[str]:
    """Accept one WebSocket and say a last word in the same breath as the answer to the handshake."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(DEADLINE_S)

        def answer() -> None:
            connection, _ = listening.accept()
            with connection:
                head = b""
                while not head.endswith(b"\r\n\r\n"):
                    head += connection.recv(4096)
                key = next(line for line in head.split(b"\r\n") if line.lower().startswith(b"sec-websocket-key"))
                digest = hashlib.sha1(key.split()[1] + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest()  # noqa: S324
                lines = [b"HTTP/1.1 101 X", b"Upgrade: websocket", b"Connection: Upgrade"]
                lines += [b"Sec-WebSocket-Accept: " + base64.b64encode(digest), b"", b""]
                connection.sendall(b"\r\n".join(lines) + farewell)
                connection.shutdown(socket.SHUT_WR)
                with contextlib.suppress(OSError):
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
