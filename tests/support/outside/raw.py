"""A WebSocket client without a library, which may say what is wrong, and plain HTTP."""

from __future__ import annotations

import base64
import contextlib
import http.client
import os
import socket
import struct
import urllib.parse

from tests.support.peer import DEADLINE_S
from xpl.wire import codec

CONTINUATION, TEXT, BINARY, CLOSE, PING, PONG = 0, 1, 2, 8, 9, 10


class Raw:
    """A WebSocket connection frame by frame, wrong ones too.

    Attributes:
        status: HTTP status of the answer to the opening handshake.
    """

    def __init__(self, url: str, *headers: str, host: str = "127.0.0.1") -> None:
        self._socket = dial(url)
        key = base64.b64encode(os.urandom(16)).decode()
        lines = ["GET / HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Version: 13", f"Sec-WebSocket-Key: {key}", *headers]
        self._socket.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            head += self._read(1)
        self.status = int(head.split()[1])

    def send(
        self, kind: int, payload: bytes = b"", *, last: bool = True, reserved: int = 0, size: int | None = None
    ) -> None:
        """Send a frame; `size` is what it says of its length."""
        announced = len(payload) if size is None else size
        head = bytes([last << 7 | reserved << 4 | kind])
        if announced < 126:
            head += bytes([0x80 | announced])
        elif announced < 1 << 16:
            head += bytes([0x80 | 126]) + struct.pack("!H", announced)
        else:
            head += bytes([0x80 | 127]) + struct.pack("!Q", announced)
        self._socket.sendall(head + bytes(4) + payload)  # masked with zeros, which changes nothing

    def receive(self) -> tuple[int, bytes]:
        """Return opcode and payload of the next frame."""
        first, length = self._read(2)
        if length >= 126:
            (length,) = struct.unpack("!H" if length == 126 else "!Q", self._read(2 if length == 126 else 8))
        return first & 0x0F, self._read(length)

    def closed(self) -> tuple[int, str]:
        """Return code and reason of the close frame that comes next."""
        kind, payload = self.receive()
        assert kind == CLOSE
        return int.from_bytes(payload[:2], "big"), payload[2:].decode()

    def ask(self, data: bytes) -> codec.Frame:
        """Send a whole message and return the answer."""
        self.send(BINARY, data)
        return codec.decode(self.receive()[1])

    def close(self) -> None:
        """Hang up."""
        self._socket.close()

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            more = self._socket.recv(size - len(data))
            if not more:
                raise EOFError
            data += more
        return data


def dial(url: str) -> socket.socket:
    """Return a TCP connection to a server."""
    return socket.create_connection(("127.0.0.1", urllib.parse.urlsplit(url).port or 0), timeout=DEADLINE_S)


def page(url: str, path: str, **headers: str) -> tuple[int, str]:
    """Return status and text of a page."""
    asked = http.client.HTTPConnection("127.0.0.1", urllib.parse.urlsplit(url).port or 0, timeout=DEADLINE_S)
    with contextlib.closing(asked):
        asked.request("GET", path, headers=headers)
        answer = asked.getresponse()
        return answer.status, answer.read().decode()
