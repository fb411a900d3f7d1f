"""A TCP relay between a client and a server that cuts the connection on request."""

from __future__ import annotations

import contextlib
import socket
import threading
import urllib.parse
from typing import Final, Self

_CHUNK = 1 << 16
PAUSE_S: Final = 0.3
"""Time without connections after a cut, s."""
_REQUEST, _ANSWER = "request", "answer"


class CuttingRelay:
    """Forwards bytes between clients and a server, until a cut; a context manager.

    Args:
        url: the server's address.

    Attributes:
        url: where clients connect.
    """

    def __init__(self, url: str) -> None:
        address = urllib.parse.urlsplit(url)
        self._address = (address.hostname or "localhost", address.port or 0)
        self._cut_direction: str | None = None
        self._stopped = threading.Event()
        self._sockets: list[socket.socket] = []
        self._lock = threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self.url = f"{address.scheme}://127.0.0.1:{self._listening.getsockname()[1]}"

    def cut_answer(self) -> str:
        """Drop the next answer of the server, and the connection; return a description."""
        self._cut_direction = _ANSWER
        return "the answer was lost"

    def cut_request(self) -> str:
        """Drop the connection in the middle of the client's next request; return a description."""
        self._cut_direction = _REQUEST
        return "the request broke off in the middle"

    def __enter__(self) -> Self:
        self._accepting.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._close()
        with contextlib.suppress(OSError):  # wakes the accepting thread
            self._listening.shutdown(socket.SHUT_RDWR)
        self._accepting.join()
        self._listening.close()

    def _accept(self) -> None:
        while not self._stopped.is_set():
            try:
                client, _ = self._listening.accept()
                server = socket.create_connection(self._address)
            except OSError:
                return
            with self._lock:
                self._sockets += [client, server]
            pumps = [
                threading.Thread(target=self._pump, args=(*ends, what), daemon=True)
                for ends, what in (((client, server), _REQUEST), ((server, client), _ANSWER))
            ]
            for pump in pumps:
                pump.start()
            for pump in pumps:
                pump.join()
            self._stopped.wait(PAUSE_S)  # one client at a time: a client that reconnects after a cut waits

    def _pump(self, source: socket.socket, target: socket.socket, what: str) -> None:
        """Forward bytes in one direction."""
        with contextlib.suppress(OSError):
            while data := source.recv(_CHUNK):
                if self._cut_direction == what:
                    self._cut_direction = None
                    if what == _REQUEST:
                        source.shutdown(socket.SHUT_RDWR)  # first: no answer to the half may reach the client
                        target.sendall(data[: len(data) // 2])
                    break
                target.sendall(data)
        self._close()

    def _close(self) -> None:
        with self._lock:
            sockets, self._sockets = self._sockets, []
        for end in sockets:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
