"""The mock of RoboDojo as a TASK_ENV: `make(config)`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xpl.environment import read_manifest

from .task_env import RoboDojoEnv


def make(config: Mapping[str, Any]) -> RoboDojoEnv:
    """Return the environment for a configuration: task, embodiment, action_type, num_envs, max_steps, cameras, ..."""
    return RoboDojoEnv(read_manifest(__file__), config)
