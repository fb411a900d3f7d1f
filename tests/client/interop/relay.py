"""A relay between a peer and a server."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from types import TracebackType
from typing import Self
from urllib.parse import urlsplit


class Relay:
    """An address that stays while the server behind it changes, and whose connections can be cut.

    Attributes:
        url: where it answers.
        target: `ws://host:port` of the server for connections to come.
    """

    def __init__(self, target: str) -> None:
        self.target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"ws://127.0.0.1:{self._listener.getsockname()[1]}"
        self._open: set[socket.socket] = set()
        self._carriers: list[threading.Thread] = []
        self._acceptor = threading.Thread(target=self._accept)
        self._acceptor.start()

    def cut(self) -> None:
        for side in list(self._open):
            with contextlib.suppress(OSError):
                side.shutdown(socket.SHUT_RDWR)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._acceptor.join()
        self.cut()
        for carrier in self._carriers:
            carrier.join()
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            address = urlsplit(self.target)
            try:
                server = socket.create_connection((address.hostname or "", address.port or 0))
            except OSError:
                client.close()
                continue
            self._open |= {client, server}
            self._carriers.append(threading.Thread(target=self._carry, args=(client, server)))
            self._carriers[-1].start()

    def _carry(self, client: socket.socket, server: socket.socket) -> None:
        other = {client: server, server: client}
        # A socket that is gone is an error here, and the end of both.
        with contextlib.suppress(OSError), client, server, selectors.DefaultSelector() as selector:
            for side in other:
                selector.register(side, selectors.EVENT_READ, data=side)
            while all(self._pass_on(key.data, other[key.data]) for key, _ in selector.select()):
                pass
        self._open -= {client, server}

    @staticmethod
    def _pass_on(source: socket.socket, sink: socket.socket) -> bool:
        data = source.recv(1 << 16)
        sink.sendall(data)
        return bool(data)
