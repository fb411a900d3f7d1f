"""The model that every contender serves: it costs a stated time and always answers alike."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from benchmarks.serving_bench.payloads import actions, arrays

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True)
class Model:
    """A model whose forward pass on a batch of B takes `fixed_ms + B * sample_ms`.

    It waits instead of computing, as the host of an accelerator does, so that a small machine can be the host.
    """

    fixed_ms: float = 0.0
    sample_ms: float = 0.0

    def __call__(self, observations: list[dict[str, Any]]) -> np.ndarray:
        """Return the actions of a batch of observations, (B, CHUNK, ACTION_DIM) float32."""
        for array in arrays(observations):
            array.flat[0]  # what a lazy decoder left undone is done here
        self.think(len(observations))
        return actions(len(observations))

    def think(self, batch: int) -> None:
        """Take as long as a forward pass does."""
        cost = self.fixed_ms + batch * self.sample_ms
        if cost:
            time.sleep(cost / 1000)
