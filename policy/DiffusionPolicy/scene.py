"""The state of the scene as a vector, from a simulator's ground truth, for policies without cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xpl import rotation

DECIMETRES = 10.0


def scene(truth: Mapping[str, Any]) -> np.ndarray:
    """Return where things are, (D,) float32: positions in decimetres, about one in size: they need no statistics.

    Of each object its position and the x and y axes of its frame, of each goal its position and direction, in the order
    of their names. Of Meta-World its own observation: hand, objects and goal, without the step before.
    """
    if "observation" in truth:
        seen = np.asarray(truth["observation"])
        return np.concatenate([seen[:18], seen[36:39]]).astype(np.float32) * np.float32(DECIMETRES / 2)
    parts = []
    for _, thing in sorted((truth.get("objects") or {}).items()):
        pose = np.asarray(thing["pose"], np.float64)
        parts += [pose[:3] * DECIMETRES, rotation.to_matrix(pose[3:])[:, :2].T.ravel()]
    for _, goal in sorted((truth.get("goals") or {}).items()):
        yaw = float(goal.get("yaw", 0.0))
        parts += [np.asarray(goal["position"]) * DECIMETRES, np.array([np.cos(yaw), np.sin(yaw)])]
    return np.concatenate(parts).astype(np.float32)
