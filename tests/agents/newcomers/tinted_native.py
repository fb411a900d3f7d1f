"""Answers as its authors run it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .network import Runner

CONVENTIONS = {
    "action_reference": "network.py:22",
    "angle_unit": "network.py:31",
    "camera": "network.py:31",
    "chunk": "network.py:31",
    "gripper": "network.py:25",
    "image_channels": "network.py:35",
    "image_filter": "network.py:34",
    "image_orientation": "network.py:34",
    "image_range": "network.py:35",
    "image_size": "network.py:34",
    "joint_order": "network.py:36",
}
SIDES, OPEN = ("left", "right"), 0.085


def answers(config: Mapping[str, Any]) -> Callable[[Any], list[dict[str, np.ndarray]]]:
    """Return what answers an episode."""
    runner = Runner(dict(np.load(Path(__file__).parent / "checkpoints" / config["ckpt_name"])))

    def answer(episode: Any) -> list[dict[str, np.ndarray]]:
        now = episode.observations[-1]
        arms = [np.asarray(now["state"][f"{side}_arm_joint_state"]) for side in SIDES]
        metres = [float(now["state"][f"{side}_ee_joint_state"][0]) * OPEN for side in SIDES]
        rows = runner.act(arms, metres, now["vision"]["cam_head"]["color"])
        return [
            {
                key: value
                for side, part in zip(SIDES, np.split(row, 2), strict=True)
                for key, value in (
                    (f"{side}_arm_joint_state", part[:-1]),
                    (f"{side}_ee_joint_state", np.clip(part[-1:] / OPEN, 0, 1)),
                )
            }
            for row in rows
        ]

    return answer
