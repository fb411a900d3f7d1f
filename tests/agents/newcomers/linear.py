"""A linear policy in numpy: the next targets are an affine map of the state."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


class Linear:
    """Maps states (B, D) to targets (B, H * D)."""

    def __init__(self, saved: Mapping[str, np.ndarray]) -> None:
        self._matrix, self._offset = saved["matrix"], saved["offset"]

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Return the targets of a batch of states."""
        return np.asarray(states @ self._matrix + self._offset)
