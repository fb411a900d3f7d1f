"""Expert of a benchmark: the environment runs the benchmark's own expert, and puts its action into `privileged`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xpl import Policy
from xpl import _spec as spec
from xpl.action import pack
from xpl.observation import ObservationError

EXPERT = "expert"
"""Key of the expert's action in the privileged observation."""


class Model(Policy):
    """Executes the expert's action of each observation."""

    def load(self, config: Mapping[str, Any]) -> None:
        """Load nothing: the policy has no weights."""

    def encode(self, obs: Mapping[str, Any], env: int) -> np.ndarray:
        """Return the expert's action, flat (D,)."""
        truth = obs.get(spec.Obs.PRIVILEGED)
        step = truth.get(EXPERT) if isinstance(truth, Mapping) else None
        if not isinstance(step, Mapping):
            raise ObservationError(
                f"benchmark_expert executes {spec.Obs.PRIVILEGED}[{EXPERT!r}] of the observation, which is missing: "
                f"this environment has no expert for the task, or was not asked for privileged observations"
            )
        return pack(step, self.embodiment, self.action_type)

    def predict(self, inputs: list[np.ndarray], envs: list[int]) -> np.ndarray:
        """Return chunks of one action, (B, 1, D)."""
        return np.stack(inputs)[:, None]
