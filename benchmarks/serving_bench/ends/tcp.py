"""Raw TCP: the floor. Length and bytes there, length and bytes back; no frames, no codec."""

from __future__ import annotations

import socket
import socketserver
from collections.abc import Callable
from typing import TYPE_CHECKING

from benchmarks.serving_bench.payloads import HEAD, Payload, actions

if TYPE_CHECKING:
    from benchmarks.serving_bench.ends import Ask, Ready
    from benchmarks.serving_bench.model import Model


def serve(model: Model, setting: str, ready: Ready) -> None:  # noqa: ARG001 - it has one setting
    """Serve on a free port of this host, a thread for each connection."""

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            receive = _receiver(self.request)
            while message := receive():
                model.think(message[1])
                answer = actions(message[1])
                self.request.sendall(HEAD.pack(answer.nbytes, message[1]) + answer.tobytes())

    socketserver.ThreadingTCPServer.daemon_threads = True
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        ready(f"127.0.0.1:{server.server_address[1]}")
        server.serve_forever()


class TcpConnection:
    """A connected socket."""

    def __init__(self, address: str) -> None:
        host, port = address.split(":")
        self._socket = socket.create_connection((host, int(port)))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._receive = _receiver(self._socket)

    def asking(self, payload: Payload) -> Ask:
        """Return the function that sends the payload's bytes."""
        request = payload.raw

        async def ask() -> None:
            self._socket.sendall(request)
            self._receive()

        return ask

    async def close(self) -> None:
        """Close the socket."""
        self._socket.close()


async def connect(address: str, setting: str) -> TcpConnection:  # noqa: ARG001 - it has one setting
    """Connect."""
    return TcpConnection(address)


def _receiver(connection: socket.socket) -> Callable[[], tuple[memoryview, int] | None]:
    """Return a function that receives a message into a buffer that is made once, or None at the end."""
    head = bytearray(HEAD.size)
    buffer = memoryview(bytearray(16 * 2**20))

    def fill(view: memoryview) -> bool:
        while view:
            count = connection.recv_into(view)
            if not count:
                return False
            view = view[count:]
        return True

    def receive() -> tuple[memoryview, int] | None:
        if not fill(memoryview(head)):
            return None
        size, batch = HEAD.unpack(head)
        return (buffer[:size], batch) if fill(buffer[:size]) else None

    return receive
