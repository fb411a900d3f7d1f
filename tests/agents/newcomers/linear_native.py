"""Answers as its authors run it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .network import Runner

CONVENTIONS = {
    "action_reference": "network.py:31",
    "angle_unit": "network.py:22",
    "chunk": "network.py:31",
    "gripper": "network.py:22",
    "joint_order": "network.py:29",
    "normalization": "network.py:30",
}


def answers(config: Mapping[str, Any]) -> Callable[[Any], list[dict[str, np.ndarray]]]:
    """Return what answers an episode."""
    runner = Runner(dict(np.load(Path(__file__).parent / "checkpoints" / config["ckpt_name"])))

    def answer(episode: Any) -> list[dict[str, np.ndarray]]:
        state = episode.observations[-1]["state"]
        rows = runner.act(np.asarray(state["arm_joint_state"]), float(state["ee_joint_state"][0]))
        return [{"arm_joint_state": row[:-1], "ee_joint_state": np.clip(row[-1:], 0, 1)} for row in rows]

    return answer
