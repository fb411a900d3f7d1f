"""Drives openpi's own client, as its package has it.

Runs in the peers' interpreter, started by the tests; `lines` says how they talk.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from lines import answer
from openpi_client.websocket_client_policy import WebsocketClientPolicy

_open: dict[str, WebsocketClientPolicy] = {}


def connect(host: str, port: int, api_key: str | None = None) -> dict[str, Any]:
    _open["policy"] = WebsocketClientPolicy(host, port, api_key)
    return dict(_open["policy"].get_server_metadata())


def observation(image: int) -> dict[str, Any]:
    """Return what `make_droid_example` of openpi makes, but for the numbers."""
    return {
        "observation/exterior_image_1_left": np.full((224, 224, 3), image, dtype=np.uint8),
        "observation/wrist_image_left": np.zeros((224, 224, 3), dtype=np.uint8),
        "observation/joint_position": np.arange(7) / 10,
        "observation/gripper_position": np.array([0.75]),
        "prompt": "do something",
    }


def infer(image: int, **others: Any) -> dict[str, Any]:
    result = _open["policy"].infer({**observation(image), **others})
    actions = result["actions"]
    return {"actions": actions.tolist(), "dtype": str(actions.dtype), "timing": sorted(result["server_timing"])}


def close() -> None:
    _open.pop("policy")._ws.close()  # it offers no other way


if __name__ == "__main__":
    answer({"connect": connect, "infer": infer, "close": close})
