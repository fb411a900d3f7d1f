"""Type names of the maps that environments, policies and models exchange.

`spec/v1/*.schema.json` defines keys, shapes and units. Nothing is checked here, but where a map enters a process.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

Observation = Mapping[str, Any]
"""Observation of one control step; read-only."""
ObservationDict = dict[str, Any]
"""An observation that the receiver may change."""
State = Mapping[str, Any]
"""The robot's state in an observation: numbers by key."""
Action = Mapping[str, Any]
"""One action step as received: arrays or lists of numbers by key."""
ActionStep = dict[str, "np.ndarray"]
"""One action step of the SDK: float32 arrays by key."""
Report = dict[str, Any]
"""Report of an environment about one action step that it executed."""
Result = dict[str, Any]
"""Outcome of an episode so far."""
Config = Mapping[str, Any]
"""Values of deploy.yml after overrides, or the configuration of an environment."""
Entry = Mapping[str, Any]
"""A map of a document: of the block `model_io`, of a robot's file, of a change to one."""
Payload = dict[str, Any]
"""The entries of a frame of the wire."""
Announcement = Mapping[str, Any]
"""What a policy needs, or an environment offers, as announced in hello (`xpl.client.agreement`)."""
