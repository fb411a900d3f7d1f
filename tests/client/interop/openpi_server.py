"""A server of openpi's kind on the codec of its package and websockets: what its websocket_policy_server.py does.

Runs in the peers' interpreter, started by the tests; `lines` says how they talk. It holds the state that it is shown.
"""

from __future__ import annotations

import threading
import traceback
from typing import Any

import numpy as np
from lines import answer
from openpi_client import msgpack_numpy
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection
from websockets.sync.server import serve as listen

_seen: list[dict[str, Any]] = []


def infer(obs: dict[str, Any]) -> dict[str, Any]:
    _seen.append({name: [str(np.asarray(value).dtype), list(np.shape(value))] for name, value in obs.items()})
    if obs["prompt"] == "fall over":
        raise ValueError("the gripper is unhappy")
    state = np.concatenate([obs["observation/joint_position"], obs["observation/gripper_position"]])
    return {"actions": np.stack([state, state]).astype(np.float64), "state": state}


def attend(connection: ServerConnection) -> None:
    packer = msgpack_numpy.Packer()
    connection.send(packer.pack({"action_horizon": np.int64(2)}))
    while True:
        try:
            result = infer(msgpack_numpy.unpackb(connection.recv()))
            result["server_timing"] = {"infer_ms": 0.1}
            connection.send(packer.pack(result))
        except ConnectionClosed:
            return
        except Exception:  # noqa: BLE001 - as openpi does
            connection.send(traceback.format_exc())
            connection.close(1011, "Internal server error. Traceback included in previous frame.")
            return


def start() -> str:
    server = listen(attend, "127.0.0.1", 0, compression=None, max_size=None)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"ws://127.0.0.1:{server.socket.getsockname()[1]}"


if __name__ == "__main__":
    answer({"start": start, "seen": lambda: _seen})
