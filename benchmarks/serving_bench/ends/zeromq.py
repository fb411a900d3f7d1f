"""A ZeroMQ REQ/REP loop as people write it: a msgpack header, then one frame per array.

Setting `default` is TCP on loopback with copies; `best` is a Unix socket and `copy=False`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np
import zmq

if TYPE_CHECKING:
    from benchmarks.serving_bench.ends import Ask, Ready
    from benchmarks.serving_bench.model import Model
    from benchmarks.serving_bench.payloads import Payload


def serve(model: Model, setting: str, ready: Ready) -> None:
    """Serve one request after the other."""
    copy = setting != "best"
    with tempfile.TemporaryDirectory(prefix="xpl-bench-") as folder, zmq.Context() as context:
        replies = context.socket(zmq.REP)
        replies.bind("tcp://127.0.0.1:*" if copy else f"ipc://{Path(folder) / 'socket'}")
        ready(replies.getsockopt_string(zmq.LAST_ENDPOINT))
        while True:
            observations = _unpack(replies.recv_multipart(copy=copy))
            replies.send_multipart(_pack(model(observations)), copy=copy)


class ZeromqConnection:
    """A REQ socket."""

    def __init__(self, address: str, *, copy: bool) -> None:
        self._copy = copy
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.REQ)
        self._socket.connect(address)

    def asking(self, payload: Payload) -> Ask:
        """Return the function that sends the payload's observations."""

        async def ask() -> Any:
            self._socket.send_multipart(_pack(payload.observations), copy=self._copy)
            return _unpack(self._socket.recv_multipart(copy=self._copy))

        return ask

    async def close(self) -> None:
        """Close the socket."""
        self._context.destroy(linger=0)


async def connect(address: str, setting: str) -> ZeromqConnection:
    """Connect."""
    return ZeromqConnection(address, copy=setting != "best")


def _pack(value: Any) -> list[Any]:
    """Return the frames of a value: its tree, in which an array is an extension, and the arrays themselves."""
    frames: list[Any] = []

    def on_array(array: np.ndarray) -> msgpack.ExtType:
        frames.append(array)
        return msgpack.ExtType(0, msgpack.packb((array.dtype.str, array.shape)))

    return [msgpack.packb(value, default=on_array), *frames]


def _unpack(frames: list[Any]) -> Any:
    buffers = iter([memoryview(frame) for frame in frames[1:]])

    def on_extension(_: int, data: bytes) -> np.ndarray:
        dtype, shape = msgpack.unpackb(data)
        return np.frombuffer(next(buffers), dtype).reshape(shape)

    return msgpack.unpackb(memoryview(frames[0]), ext_hook=on_extension)
