"""openpi's wire as openpi speaks it, written anew: what its client and its server do, on the real websockets library.

After Physical-Intelligence/openpi: packages/openpi-client (websocket_client_policy.py, msgpack_numpy.py) and
src/openpi/serving/websocket_policy_server.py. Nothing here is ours, so that a fault of our codec shows.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any, Self

import msgpack
import numpy as np
import websockets.sync.client
import websockets.sync.server
from websockets.exceptions import ConnectionClosed

DEADLINE_S = 100.0
METADATA = {"reset_pose": [0.0, -1.5]}


def _outgoing(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic):
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    return value


def _incoming(entries: dict[Any, Any]) -> Any:
    if b"__ndarray__" in entries:
        return np.ndarray(buffer=entries[b"data"], dtype=np.dtype(entries[b"dtype"]), shape=entries[b"shape"])
    if b"__npgeneric__" in entries:
        return np.dtype(entries[b"dtype"]).type(entries[b"data"])
    return entries


def pack(value: Any) -> bytes:
    """Return the message of a value."""
    packed: bytes = msgpack.packb(value, default=_outgoing)
    return packed


def unpack(data: bytes) -> Any:
    """Return the value of a message."""
    return msgpack.unpackb(data, object_hook=_incoming)


class OpenpiPeer:
    """openpi's client: it waits for the metadata, then asks."""

    def __init__(self, url: str, api_key: str | None = None) -> None:
        headers = {"Authorization": f"Api-Key {api_key}"} if api_key else None
        self._open = contextlib.ExitStack()
        with self._open:
            self.socket = self._open.enter_context(
                websockets.sync.client.connect(
                    url, compression=None, max_size=None, additional_headers=headers, proxy=None
                )
            )
            self.metadata = unpack(self._received())
            self._open = self._open.pop_all()

    def infer(self, obs: Any) -> Any:
        """Return the answer to an observation; text is an error."""
        self.socket.send(pack(obs))
        response = self._received()
        if isinstance(response, str):
            raise RuntimeError(f"Error in inference server:\n{response}")  # noqa: TRY004 - as openpi does
        return unpack(response)

    def cut(self) -> None:
        """Lose the connection without a word of the protocol."""
        self.socket.socket.shutdown(socket.SHUT_RDWR)

    def _received(self) -> Any:
        return self.socket.recv(timeout=DEADLINE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()


@contextlib.contextmanager
def policy_server(infer: Callable[[dict[str, Any]], Any], hello: bytes | str | None = None) -> Iterator[str]:
    """Serve a function as openpi's server would, for the length of a `with` block; yield the address.

    Args:
        infer: returns the answer to an observation; what it raises is sent as text, and the connection is closed;
            at ConnectionAbortedError it is cut without a word.
        hello: what is sent first instead of the metadata.
    """

    def talk(connection: websockets.sync.server.ServerConnection) -> None:
        connection.send(pack(METADATA) if hello is None else hello)
        while True:
            try:
                received = connection.recv()
                assert isinstance(received, bytes)
                connection.send(pack(infer(unpack(received))))
            except ConnectionClosed:
                return
            except ConnectionAbortedError:
                connection.socket.shutdown(socket.SHUT_RDWR)
                return
            except Exception:  # noqa: BLE001 - as openpi does
                connection.send(traceback.format_exc())
                connection.close(1011, "Internal server error. Traceback included in previous frame.")
                return

    with websockets.sync.server.serve(talk, "127.0.0.1", 0, compression=None, max_size=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join()
