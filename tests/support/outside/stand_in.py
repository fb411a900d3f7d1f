"""Servers of our own making, on the real websockets library: what another make of server may say."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import websockets.sync.server

from xpl.wire import codec

if TYPE_CHECKING:
    from xpl.wire.codec import Frame


@contextlib.contextmanager
def standing_in(answer: Callable[[Frame], Frame | None]) -> Iterator[tuple[str, list[Frame]]]:
    """Serve what a function answers; yield the address, and the requests as they arrive."""
    requests: list[Frame] = []

    def talk(connection: websockets.sync.server.ServerConnection) -> None:
        for data in connection:
            assert isinstance(data, bytes)
            requests.append(codec.decode(data))
            answered = answer(requests[-1])
            if answered is not None:
                connection.send(codec.encode(answered))

    with websockets.sync.server.serve(talk, "127.0.0.1", 0, compression=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}", requests
        finally:
            server.shutdown()
            thread.join()
