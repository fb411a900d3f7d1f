"""Servers of our own making, on the real websockets library: what another make of server may say."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import websockets.sync.server

from xpl.wire import codec
from xpl.wire.codec import Frame


@contextlib.contextmanager
def fake_server(answer: Callable[[Frame], Any]) -> Iterator[tuple[str, list[Frame]]]:
    """Serve what a function answers; yield the address, and the requests as they arrive.

    Args:
        answer: returns a frame, a message as it is, code and reason to close with, or None; or a list of them.
    """
    requests: list[Frame] = []

    def talk(connection: websockets.sync.server.ServerConnection) -> None:
        for data in connection:
            assert isinstance(data, bytes)
            requests.append(codec.decode(data))
            answers = answer(requests[-1])
            for one in answers if isinstance(answers, list) else [answers]:
                if isinstance(one, tuple):
                    connection.close(*one)
                elif one is not None:
                    connection.send(codec.encode(one) if isinstance(one, Frame) else one)

    with websockets.sync.server.serve(talk, "127.0.0.1", 0, compression=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}", requests
        finally:
            server.shutdown()
            thread.join()
