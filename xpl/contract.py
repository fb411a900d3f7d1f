"""Names for the maps that travel between environments, policies and models.

A name says which map it is; keys, shapes and units stand in `spec/v1/*.schema.json`. Nothing is checked here: whoever
takes a map from outside does that.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

Observation = Mapping[str, Any]
"""What an environment shows of itself at one control step, to be read only."""
ObservationDict = dict[str, Any]
"""An observation that whoever gets it may change."""
State = Mapping[str, Any]
"""The robot's state in an observation: numbers by key."""
Action = Mapping[str, Any]
"""One action step as it comes: arrays or lists of numbers by key."""
ActionStep = dict[str, "np.ndarray"]
"""One action step of ours: float32 arrays by key."""
Report = dict[str, Any]
"""What an environment says of one action step that it executed."""
Result = dict[str, Any]
"""How an episode went, so far."""
Config = Mapping[str, Any]
"""Values of deploy.yml after overrides, or the configuration of an environment."""
Entry = Mapping[str, Any]
"""A map of a document: of the block `model_io`, of a robot's file, of a change to one."""
Payload = dict[str, Any]
"""The entries of a frame of the wire."""
Announcement = Mapping[str, Any]
"""What a policy needs, or an environment offers, as said in hello (`xpl.client.agreement`)."""
