"""A linear policy in numpy: the next targets are an affine map of the state. Its authors' code."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


class Linear:
    """Maps states (B, D) to targets (B, H * D)."""

    def __init__(self, saved: Mapping[str, np.ndarray]) -> None:
        self._matrix, self._offset = saved["matrix"], saved["offset"]

    def __call__(self, state: np.ndarray) -> np.ndarray:
        """Return the targets of a batch of states."""
        return np.asarray(state @ self._matrix + self._offset)


class Runner:
    """How its authors run it: joints in rad, then the opening of the gripper, 0 closed and 1 open."""

    def __init__(self, saved: Mapping[str, np.ndarray]) -> None:
        self._saved, self._network = saved, Linear(saved)

    def act(self, joints: np.ndarray, opening: float) -> np.ndarray:
        """Return targets (H, D) for one state."""
        state = np.append(joints, opening)
        inner = self._network(((state - self._saved["state_mean"]) / self._saved["state_std"])[None])
        return np.asarray(inner.reshape(-1, len(state)) * self._saved["action_std"] + self._saved["action_mean"])
