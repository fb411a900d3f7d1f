"""Answers of Tiny_VLA's network with no conversion of xpl's: a second reading, which the adapter is held against.

The demonstrations are files of the standard, so their words are the standard's; what training made of them is written
out here once more, number by number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

CONVENTIONS = {
    "image_channels": "process_data.py:25",
    "image_orientation": "process_data.py:25",
    "image_size": "network.py:26",
    "image_filter": "policy.yml:38",
    "image_range": "network.py:137",
    "camera": "network.py:24",
    "joint_order": "process_data.py:25",
    "angle_unit": "process_data.py:25",
    "gripper": "train.py:48",
    "action_reference": "network.py:117",
    "chunk": "process_data.py:19",
    "instruction": "network.py:29",
    "normalization": "policy.yml:47",
}

MIDDLE = np.array([0.0, 1.55, 1.25, -1.1, 0.0, 0.0, 0.5])
SPREAD = np.array([0.5, 0.3, 0.25, 0.2, 0.1, 0.6, 0.5])
EXECUTED = 8


def answers(config: Mapping[str, Any]) -> Callable[[Any], list[dict[str, np.ndarray]]]:
    """Return what answers an episode; `config` is deploy.yml after overrides."""
    import torch

    from .network import pieces, read

    here, name = Path(__file__).parent, str(config["ckpt_name"])
    places = [here / name, here / "checkpoints" / name]
    network = read(next(place for place in places if place.exists())).eval()

    def answer(episode: Any) -> list[dict[str, np.ndarray]]:
        """Return the action steps of what the network says now."""
        now = episode.observations[-1]
        state = np.concatenate([now["state"]["arm_joint_state"], now["state"]["ee_joint_state"]])
        with torch.inference_mode():
            chunk, _ = network(
                head=torch.from_numpy(now["vision"]["cam_head"]["color"])[None],
                wrist=torch.from_numpy(now["vision"]["cam_wrist"]["color"])[None],
                state=torch.from_numpy(((state - MIDDLE) / SPREAD).astype(np.float32))[None],
                instruction=torch.from_numpy(pieces([now.get("instruction", "")])),
            )
        rows = chunk[0, :EXECUTED].double().numpy() * SPREAD + MIDDLE
        return [{"arm_joint_state": row[:6], "ee_joint_state": np.clip(row[6:], 0, 1)} for row in rows]

    return answer
