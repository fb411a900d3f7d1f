"""Convert RoboTwin's observations and actions to the standard's, and back: `conventions` in env.yml, in code.

Source: RoboTwin-Platform/RoboTwin, scripts/eval_policy_xpolicylab.py at cf47ab5, which converts for the ecosystem's
client. Two things differ: extrinsic matrices get their fourth row, and an action that lacks an arm is refused, where
RoboTwin silently holds that arm.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xpl import _spec as spec
from xpl.action import ActionError, action_dim, pack
from xpl.embodiment import Embodiment

ACTION_TYPES = {"joint": "qpos", "ee": "ee"}
SIDES = ("left", "right")
_LAST_ROW = [[0.0, 0.0, 0.0, 1.0]]


def observation(  # noqa: PLR0913 - by keyword, what RoboTwin keeps in several places
    theirs: Mapping[str, Any],
    *,
    cameras: Mapping[str, Mapping[str, Any]],
    robot: Any,
    instruction: str,
    frequency: float,
    env_idx: int = 0,
) -> dict[str, Any]:
    """Return the standard observation of RoboTwin's `get_obs`.

    Args:
        theirs: RoboTwin's observation.
        cameras: those of env.yml.
        robot: RoboTwin's robot, which has the poses of the tools; None to omit them.
        instruction: of the episode.
        frequency: that policies get, Hz.
        env_idx: index of the environment.
    """
    return {
        spec.Obs.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
        spec.Obs.INSTRUCTION: instruction,
        spec.Obs.INSTRUCTIONS: [instruction] if instruction else [],
        spec.Obs.ENV_IDX: env_idx,
        spec.Obs.VISION: vision(theirs, cameras),
        spec.Obs.STATE: state(theirs, robot),
        spec.Obs.ADDITIONAL_INFO: {spec.Obs.FREQUENCY: frequency},
    }


def vision(theirs: Mapping[str, Any], cameras: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the cameras: colour (H, W, 3) uint8 RGB and, if RoboTwin has them, matrices, float32."""
    seen = theirs.get("observation", {})
    return {name: _camera(seen[facts["source"]]) for name, facts in cameras.items() if facts["source"] in seen}


def of_robot(robot: Any) -> dict[str, Any]:
    """Return the robot's part of RoboTwin's `get_obs`, by the same operations, without rendering cameras."""
    joints, poses = {}, {}
    for side in SIDES:
        *joints[f"{side}_arm"], joints[f"{side}_gripper"] = getattr(robot, f"get_{side}_arm_jointState")()
        poses[f"{side}_endpose"] = getattr(robot, f"get_{side}_ee_pose")()
    return {"joint_action": joints, "endpose": poses}


def state(theirs: Mapping[str, Any], robot: Any = None) -> dict[str, NDArray[np.float32]]:
    """Return the robot's state: joints (6,) rad, grippers (1,) 0 closed to 1 open, poses (7,)."""
    joints, poses = theirs.get("joint_action", {}), theirs.get("endpose", {})
    values: dict[str, Any] = {}
    for side in SIDES:
        prefix = f"{side}_"
        values[prefix + spec.State.ARM_JOINT_STATE] = joints.get(f"{side}_arm")
        gripper = joints.get(f"{side}_gripper", poses.get(f"{side}_gripper"))
        values[prefix + spec.State.EE_JOINT_STATE] = None if gripper is None else [gripper]
        values[prefix + spec.State.EE_POSE] = poses.get(f"{side}_endpose")
        tell = getattr(robot, f"get_{side}_tcp_pose", None)
        values[prefix + spec.State.TCP_POSE] = None if tell is None else tell()
    return {key: np.asarray(value, np.float32) for key, value in values.items() if value is not None}


def command(action: Any, robot: Embodiment, action_type: str) -> tuple[NDArray[np.float32], str]:
    """Return what RoboTwin's `take_action` takes: a flat vector, and RoboTwin's word for the kind of action.

    Args:
        action: an action step of the standard, or the flat vector itself.
        robot: of the standard.
        action_type: "joint" or "ee".

    Raises:
        ActionError: it is neither.
    """
    word = ACTION_TYPES[action_type]
    if isinstance(action, Mapping):
        return pack(action, robot, action_type), word
    try:
        flat = np.asarray(action, np.float32)
    except (TypeError, ValueError):
        raise ActionError(f"an action is a map or a vector, got {type(action).__name__}") from None
    if flat.shape != (action_dim(robot, action_type),):
        raise ActionError(f"{word} takes {action_dim(robot, action_type)} numbers in a row, got shape {flat.shape}")
    return flat, word


def _camera(theirs: Mapping[str, Any]) -> dict[str, Any]:
    camera: dict[str, Any] = {}
    if "rgb" in theirs:
        camera[spec.Camera.COLOR] = np.asarray(theirs["rgb"])
        camera[spec.Camera.SHAPE] = np.array(camera[spec.Camera.COLOR].shape[:2])
    if spec.Camera.DEPTH in theirs:
        camera[spec.Camera.DEPTH] = np.asarray(theirs[spec.Camera.DEPTH])
    if "intrinsic_cv" in theirs:
        camera[spec.Camera.INTRINSIC_MATRIX] = np.asarray(theirs["intrinsic_cv"], np.float32)
    if "extrinsic_cv" in theirs:
        matrix = np.asarray(theirs["extrinsic_cv"], np.float32)
        whole = matrix if matrix.shape == (4, 4) else np.concatenate([matrix, np.array(_LAST_ROW, np.float32)])
        camera[spec.Camera.EXTRINSICS_MATRIX] = whole
    return camera
