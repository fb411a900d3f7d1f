"""A stand-in of the ecosystem's debug client: what it does to a loop, and where the real one is, if at all.

Its source is XPolicyLab/XPolicyLab, debug_env_client.py at 7198143e: all environments are called running for ever, and
`is_episode_end` alone tells the end, which a count of control steps brings.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.checkout import ROOT
from xpl.embodiment import get_embodiment

LIMIT = 5
BATCH = 10
_FAR_BEYOND = 20 * LIMIT


def checkout() -> Path | None:
    """Return the public repository's checkout, None where there is none: it is no part of this one."""
    for place in (os.environ.get("XPL_PUBLIC_CHECKOUT"), ROOT / ".peers" / "XPolicyLab"):
        if place and (Path(place) / "debug_env_client.py").is_file():
            return Path(place)
    return None


class NeverEndsError(AssertionError):
    """A loop went on far beyond the end of the episode."""


class DebugEnv:
    """Environments that tell their end by `is_episode_end()` alone.

    Args:
        robot: by its name in the standard.

    Attributes:
        steps: control steps, of all environments together.
    """

    guarded = True

    def __init__(self, robot: str = "arx_x5") -> None:
        self._robot = get_embodiment(robot)
        self.steps = 0

    def get_obs(self, env_idx: int = 0) -> dict[str, Any]:
        """Return an observation without content."""
        state = {name: np.zeros(size, np.float32) for name, size in self._robot.dims("joint").items()}
        return {"data_format_version": "v1.0", "instruction": "language", "env_idx": env_idx, "state": state}

    def get_obs_batch(self, env_idx_list: list[int]) -> list[dict[str, Any]]:
        """Return an observation of each."""
        return [self.get_obs(env) for env in env_idx_list]

    def take_action(self, action: Any) -> None:
        """Count."""
        self.take_action_batch([action], [0])

    def take_action_batch(self, action_list: list[Any], env_idx_list: list[int]) -> None:
        """Count, once for all."""
        assert len(action_list) == len(env_idx_list)
        self.steps += 1
        if self.steps > _FAR_BEYOND:
            raise NeverEndsError(f"{self.steps} control steps of {LIMIT}")

    def is_episode_end(self) -> bool:
        """Tell the end."""
        return self.steps >= LIMIT

    def get_running_env_idx_list(self) -> list[int]:
        """Return all of them, whatever happened."""
        return list(range(BATCH))

    def finish_episode(self) -> None:
        """Do nothing."""

    def results(self) -> list[dict[str, Any]]:
        """Return what ours tell of episodes; the debug client has no such thing."""
        return [{"env_idx": env, "steps": self.steps} for env in range(BATCH)]
