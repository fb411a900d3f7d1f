"""A policy server of the first generation on msgpack-numpy and websockets, which our client is tested against.

Runs in the peers' interpreter, started by the tests; `lines` says how they talk. It answers an observation with what it
found in it: described, and sent back.
"""

from __future__ import annotations

import threading
from typing import Any

import msgpack
import msgpack_numpy
import numpy as np
from lines import answer
from websockets.sync.server import ServerConnection
from websockets.sync.server import serve as listen

ANSWERS = {
    "hello": "hello_ack",
    "reset": "reset_result",
    "infer": "infer_result",
    "trial_end": "trial_end_ack",
    "heartbeat": "heartbeat_ack",
}


def describe(value: Any) -> list[Any]:
    if isinstance(value, (np.ndarray, np.generic)):
        kind = "array" if isinstance(value, np.ndarray) else "scalar"
        return [kind, value.dtype.str, list(value.shape), value.tobytes().hex()]
    return [type(value).__name__, repr(value)]


def attend(connection: ServerConnection) -> None:
    """Answer one connection's requests: no instance id, nothing for a call or for what cannot be understood."""
    for data in connection:
        frame = msgpack.unpackb(data, raw=False, object_hook=msgpack_numpy.decode)
        if frame["message_type"] == "close":
            return
        if frame["message_type"] not in ANSWERS:
            continue
        payload: dict[str, Any] = {"ok": True}
        if frame["message_type"] == "infer":
            values = frame["payload"]["observation"]["values"]
            payload = {"actions": [{"seen": describe(value), "echo": value} for value in values], "latency_ms": 0.1}
        reply = {**frame, "message_type": ANSWERS[frame["message_type"]], "payload": payload}
        connection.send(msgpack.packb(reply, default=msgpack_numpy.encode, use_bin_type=True))


def start() -> str:
    server = listen(attend, "127.0.0.1", 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"ws://127.0.0.1:{server.socket.getsockname()[1]}"


if __name__ == "__main__":
    answer({"start": start})
