"""Model of demo_policy: holds the current pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl import Policy
from xpl.observation import pack_state


class Model(Policy):
    """Returns an action chunk that repeats the observed state, for any robot and action type."""

    def encode(self, obs: Mapping[str, Any], env: int) -> np.ndarray:
        """Return proprioception as a flat action, (D,) float32."""
        return pack_state(obs, self.embodiment, self.action_type)

    def predict(self, inputs: Sequence[np.ndarray], envs: Sequence[int]) -> np.ndarray:
        """Return one chunk of flat actions per environment, (B, H, D)."""
        return np.repeat(np.stack(inputs)[:, None], self.chunk or 1, axis=1)
