"""RoboTwin as a TASK_ENV: `make(config)`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xpl.environment import Environment, read_manifest, require

from .episode import RoboTwinEpisode
from .upstream import check


def make(config: Mapping[str, Any]) -> Environment:
    """Return the environment for a configuration: task, embodiment, action_type, num_envs, max_steps, cameras, ...

    Raises:
        NotInstalledError: RoboTwin's code or its assets are not here; a setting of `stand_ins` needs its code alone.
        ValueError: a value is missing, unknown or not offered.
    """
    manifest = read_manifest(__file__)
    if config.get("setting") in manifest.data["stand_ins"]:
        require("robotwin", __file__)
    else:
        check()
    return Environment(RoboTwinEpisode, manifest, config)
