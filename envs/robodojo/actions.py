"""What RoboDojo takes as an action, and what it makes of it: as strict as its own client, and no stricter.

Source: RoboDojo-Benchmark/RoboDojo, src/eval_client/eval_env.py at 36bfcb7: validate_action_dict, get_action_type and
take_action_batch. A test holds this against that file, where a checkout is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.action import ActionError
from xpl.embodiment import Embodiment

POSE_DIM = 7
JOINT, EE = "joint", "ee"


def validate(action: Any, robot: Embodiment) -> None:
    """Check an action's keys and dimensions.

    Args:
        action: maps keys of the state to lists, tuples or arrays; keys may be missing.
        robot: with one arm or two.

    Raises:
        ActionError: it is no map, has a key that no robot of so many arms has, or a value that is no vector of the
            right length. RoboDojo raises ValueError, and TypeError for what is no array.
    """
    if not isinstance(action, Mapping):
        raise ActionError(f"an action must be a dict of vectors, got {type(action).__name__}")
    expected = dimensions(robot)
    unexpected = [key for key in action if key not in expected]
    if unexpected:
        raise ActionError(f"RoboDojo refuses the keys {unexpected}; it knows {', '.join(expected)}")
    for key, value in action.items():
        if not isinstance(value, (np.ndarray, list, tuple)):
            raise ActionError(f"action[{key!r}] must be a list or an array, got {type(value).__name__}")
        shape = np.asarray(value).shape
        if shape != (expected[key],):
            raise ActionError(f"action[{key!r}] must be of shape ({expected[key]},), got {shape}")


def dimensions(robot: Embodiment) -> dict[str, int]:
    """Return the length of every vector that an action may have."""
    result = {}
    for arm in robot.arms:
        lengths = {spec.State.ARM_JOINT_STATE: arm.dof, spec.State.EE_JOINT_STATE: arm.ee_dim}
        poses = dict.fromkeys((spec.State.EE_POSE, spec.State.TCP_POSE, spec.State.DELTA_EE_POSE), POSE_DIM)
        result.update({arm.prefix + name: length for name, length in {**lengths, **poses}.items()})
    return result


def kind(action: Mapping[str, Any], robot: Embodiment) -> str:
    """Return "joint" or "ee" by the keys of an action, as RoboDojo does; poses of the tool and deltas are neither.

    Raises:
        ActionError: it is neither, or both.
    """
    names = {JOINT: spec.State.ARM_JOINT_STATE, EE: spec.State.EE_POSE}
    control_types = [one for one, name in names.items() if any(arm.prefix + name in action for arm in robot.arms)]
    if len(control_types) != 1:
        problem = "cannot tell joint from ee control" if not control_types else "has both joint and ee control"
        raise ActionError(f"RoboDojo {problem} by the keys {', '.join(action) or '(none)'}: give exactly one of them")
    return control_types[0]


def controls(action: Mapping[str, Any], robot: Embodiment) -> dict[str, np.ndarray]:
    """Return what is commanded: joints or poses of every arm, and grippers within 0 to 1.

    Raises:
        ActionError: an arm or a gripper is missing. RoboDojo raises KeyError.
    """
    target = spec.State.ARM_JOINT_STATE if kind(action, robot) == JOINT else spec.State.EE_POSE
    result = {}
    for arm in robot.arms:
        for name in (target, spec.State.EE_JOINT_STATE):
            if arm.prefix + name not in action:
                raise ActionError(f"action lacks {arm.prefix + name!r}: RoboDojo moves every arm in every step")
            result[arm.prefix + name] = np.asarray(action[arm.prefix + name], np.float64)
        gripper = arm.prefix + spec.State.EE_JOINT_STATE
        if arm.ee_dim == 1:
            result[gripper] = np.clip(result[gripper], 0.0, 1.0)
    return result
