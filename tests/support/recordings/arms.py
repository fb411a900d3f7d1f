"""Rows of joints and poses that belong together, as authors' data would have them in any words of the block."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import get_embodiment, poses
from xpl.conventions import frame as frames
from xpl.convert.parts import make_part
from xpl.kinematics import Chain

if TYPE_CHECKING:
    from xpl import Embodiment

ROBOTS = ("franka_single", "piper_single", "arx_x5", "aloha_agilex", "piper_x", "franka")


def moments(
    robot: Embodiment, rng: np.random.Generator, count: int, spread: float = 1.0
) -> list[dict[str, np.ndarray]]:
    """Return states of a robot whose joints and poses agree.

    Args:
        robot: one with kinematics.
        rng: draws the joints within their limits.
        count: states.
        spread: share of the limits in which they are drawn; 0 gives one pose.
    """
    chain = Chain.from_embodiment(robot.data)
    middle = (chain.lower + chain.upper) / 2
    states: list[dict[str, np.ndarray]] = [{} for _ in range(count)]
    for side, arm in zip(robot.data["arms"], robot.arms, strict=True):
        about = rng.uniform(chain.lower, chain.upper) * 0.5 + middle * 0.5
        for state in states:
            joints = np.clip(about + spread * (rng.uniform(chain.lower, chain.upper) - about), chain.lower, chain.upper)
            state[f"{arm.prefix}arm_joint_state"] = joints
            state[f"{arm.prefix}ee_pose"] = poses.compose(frames.mount(robot, side), chain.flange(joints))
            state[f"{arm.prefix}ee_joint_state"] = rng.uniform(0, 1, arm.ee_dim)
    return states


def rows(parts: list[dict[str, Any]], robot: str, states: list[dict[str, np.ndarray]]) -> np.ndarray:
    """Return the states as rows (N, width) of a vector with these parts."""
    made = [make_part(entry, get_embodiment(robot)) for entry in parts]
    return np.stack([np.concatenate([item.read(state) for item in made]) for state in states])
