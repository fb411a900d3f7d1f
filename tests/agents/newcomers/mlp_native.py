"""Answers as its authors run it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .network import Runner

CONVENTIONS = {
    "action_reference": "network.py:50",
    "angle_unit": "network.py:35",
    "chunk": "network.py:50",
    "gripper": "network.py:35",
    "history": "network.py:46",
    "joint_order": "network.py:35",
    "normalization": "network.py:47",
}


def answers(config: Mapping[str, Any]) -> Callable[[Any], list[dict[str, np.ndarray]]]:
    """Return what answers an episode."""
    weights = Path(__file__).parent / "checkpoints" / config["ckpt_name"]
    runner = Runner(weights, weights.with_name("statistics.json"))

    def answer(episode: Any) -> list[dict[str, np.ndarray]]:
        states = [
            [*map(float, shown["state"]["arm_joint_state"]), float(shown["state"]["ee_joint_state"][0])]
            for shown in episode.observations
        ]
        rows = runner.act(states).numpy()
        return [{"arm_joint_state": row[:-1], "ee_joint_state": np.clip(row[-1:], 0, 1)} for row in rows]

    return answer
