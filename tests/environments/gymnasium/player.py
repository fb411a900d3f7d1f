"""Solve the tasks of envs/gymnasium from privileged observations: an adapter's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl import Policy
from xpl import _spec as spec

DOWN = [0.70710678, 0.0, 0.70710678, 0.0]
FLANGE = np.array([0.0, 0.0, 0.1864])  # from the point between the fingers of the Fetch
OVER = np.array([0.0, 0.0, 0.06])


class Model(Policy):
    """Identifies the task by the names of its privileged observations."""

    def load(self, config: Mapping[str, Any]) -> None:
        """Nothing is learned."""
        self._carrying: dict[int, int] = {}

    def reset_env(self, env: int) -> None:
        """Forget what was carried."""
        self._carrying.pop(env, None)

    def encode(self, obs: Mapping[str, Any], env: int) -> np.ndarray:
        """Return the flat action of one step."""
        truth, state = obs[spec.Obs.PRIVILEGED], obs[spec.Obs.STATE]
        if "block_pose" in truth:
            position, opening = _push(truth, state), 0.0
        elif "cube" in truth:
            position, opening = self._carry(truth, state, env)
        else:
            position, opening = truth["goal"] + FLANGE, 0.0
        return np.array([*position, *DOWN, opening], dtype=np.float32)

    def predict(self, inputs: Sequence[np.ndarray], envs: Sequence[int]) -> np.ndarray:
        """Return chunks of one step."""
        return np.stack(inputs)[:, None]

    def _carry(self, truth: Mapping[str, Any], state: Mapping[str, Any], env: int) -> tuple[np.ndarray, float]:
        """Go over the cube, down to it, close, and take it to the goal."""
        cube, gap = truth["cube"], state[spec.State.TCP_POSE][: spec.POSITION_DIM] - truth["cube"]
        if env not in self._carrying:
            if np.linalg.norm(gap[:2]) > 0.01:
                return cube + OVER + FLANGE, 1.0
            if np.linalg.norm(gap) > 0.02:
                return cube + FLANGE, 1.0
        self._carrying[env] = self._carrying.get(env, 0) + 1
        return (truth["goal"] if self._carrying[env] > 3 else cube) + FLANGE, 0.0


def _push(truth: Mapping[str, Any], state: Mapping[str, Any]) -> np.ndarray:
    """Go round the T to the side away from its outline, and push it there by its middle; it may turn."""
    middle, goal = _middle(truth["block_pose"]), _middle(truth["goal_pose"])
    at = np.array([state[spec.State.EE_POSE][0], 0.512 - state[spec.State.EE_POSE][1]]) * 1000  # pixels
    away, direction = at - middle, middle - goal
    gap = (np.arctan2(*direction[::-1]) - np.arctan2(*away[::-1]) + np.pi) % (2 * np.pi) - np.pi
    if np.linalg.norm(direction) < 8:
        target = at
    elif abs(gap) < 0.25:
        target = at - 8 * away / np.linalg.norm(away)
    elif np.linalg.norm(away) < 100:  # first back off
        target = at + 20 * away / np.linalg.norm(away)
    else:
        angle = np.arctan2(*away[::-1]) + np.clip(gap, -0.25, 0.25)
        target = middle + 120 * np.array([np.cos(angle), np.sin(angle)])
    step = target - at
    target = at + step * min(1.0, 30 / max(float(np.linalg.norm(step)), 1e-9))
    return np.array([target[0] / 1000, 0.512 - target[1] / 1000, 0.1])


def _middle(pose: np.ndarray) -> np.ndarray:
    """Return the middle of a T in pixels; its pose is that of the bar's edge."""
    x, y, angle = pose
    return np.array([x - 45 * np.sin(angle), y + 45 * np.cos(angle)])
