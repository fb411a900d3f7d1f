"""States of robots as one vector and back, and their dimensions.

A robot is described by `{"arm_dim": [6, 6], "ee_dim": [1, 1]}`. Vectors hold `[arm, end effector]` of each
arm, the left one first. With `action_type` "ee" an arm is its pose, seven values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import image_codec
from xpl.embodiment import get_embodiment

if TYPE_CHECKING:
    from xpl.contract import Observation

_OBS = spec.Payload.OBS
_SOURCES = (_OBS, "dataset")


def get_robot_action_dim_info(env_cfg_type: str) -> dict[str, list[int]]:
    """Return the dimensions of the robot that an environment's configuration names.

    Raises:
        UnknownEmbodimentError: if the standard has no robot of this name.
    """
    arms = get_embodiment(str(env_cfg_type)).arms
    return {"arm_dim": [arm.dof for arm in arms], "ee_dim": [arm.ee_dim for arm in arms]}


def get_action_dim(env_cfg_type: str) -> int:
    """Return how many values an action of joints has."""
    known = get_robot_action_dim_info(env_cfg_type)
    return sum(known["arm_dim"]) + sum(known["ee_dim"])


def get_batch_size(env_cfg_type: str) -> int:
    """Return how many environments run at once: one, where no benchmark says more."""
    get_embodiment(str(env_cfg_type))
    return 1


def pack_robot_state(
    obs: Observation,
    action_type: str,
    robot_action_dim_info: Mapping[str, Any],
    source_type: str = _OBS,
    state_type: str = "state",
) -> np.ndarray:
    """Return the state as one vector, (..., D).

    Args:
        obs: an observation, or a trajectory with a leading axis of time.
        action_type: "joint" or "ee".
        robot_action_dim_info: `arm_dim` and `ee_dim`, a list with one entry per arm each.
        source_type: "obs" for names of observations, "dataset" for those of trajectories, which are plural.
        state_type: key of the state.

    Raises:
        KeyError: the state lacks a key.
        ValueError: a value has another width.
    """
    state, parts = obs[state_type], []
    for key, width in _layout(action_type, robot_action_dim_info, source_type):
        if key not in state:
            raise KeyError(f"{state_type} has no {key}; it has {', '.join(map(str, state))}")
        value = np.asarray(state[key])
        if value.shape[-1:] != (width,):
            raise ValueError(f"{state_type}.{key} must have {width} values, got shape {value.shape}")
        parts.append(value)
    if len({part.shape[:-1] for part in parts}) > 1:
        raise ValueError(f"the parts of {state_type} have different lengths: {[part.shape for part in parts]}")
    return np.concatenate(parts, axis=-1)


def unpack_robot_state(
    packed_state: Any, action_type: str, robot_action_dim_info: Mapping[str, Any], source_type: str = _OBS
) -> Any:
    """Return the values of a packed vector by key, (..., width) each.

    Args:
        packed_state: (D,) or (H, D) with "obs", (..., D) with "dataset"; units of the standard.
        action_type: "joint" or "ee".
        robot_action_dim_info: `arm_dim` and `ee_dim`, a list with one entry per arm each.
        source_type: "obs" for keys of observations, "dataset" for those of trajectories, which are plural.

    Returns:
        one map; a list of H maps for a chunk (H, D) with "obs".

    Raises:
        ValueError: the last axis has another width, there are more axes than `source_type` allows, or another
            argument is not as above.
    """
    packed = np.asarray(packed_state)
    layout = list(_layout(action_type, robot_action_dim_info, source_type))
    width = sum(size for _, size in layout)
    if packed.shape[-1:] != (width,):
        raise ValueError(f"packed_state must have {width} values for {action_type!r}, got shape {packed.shape}")
    if source_type == _OBS and packed.ndim > 2:
        raise ValueError(f"packed_state must be one action or one chunk, got shape {packed.shape}")
    if source_type == _OBS and packed.ndim > 1:
        return [_named(step, layout) for step in packed]
    return _named(packed, layout)


def decode_image_bit(image_bits: Any) -> np.ndarray:
    """Return the image (H, W, 3) uint8 RGB of encoded bytes, or the images of a list of them."""
    if isinstance(image_bits, np.ndarray) and image_bits.dtype == np.uint8 and image_bits.ndim == 1:
        return image_codec.decode(image_bits)
    if isinstance(image_bits, (list, tuple, np.ndarray)):
        return np.array([decode_image_bit(bits) for bits in image_bits])
    return image_codec.decode(image_bits)


def _named(packed: np.ndarray, layout: Sequence[tuple[str, int]]) -> dict[str, np.ndarray]:
    ends = np.cumsum([width for _, width in layout])
    return {key: packed[..., end - width : end] for (key, width), end in zip(layout, ends)}


def _layout(action_type: str, robot: Mapping[str, Any], source_type: str) -> Iterator[tuple[str, int]]:
    """Yield the keys of a state with their widths, in packing order."""
    if action_type not in spec.ACTION_KEYS:
        raise ValueError(f"action_type must be one of {', '.join(spec.ACTION_TYPES)}, got {action_type!r}")
    if source_type not in _SOURCES:
        raise ValueError(f"source_type must be one of {', '.join(_SOURCES)}, got {source_type!r}")
    arm_dims, ee_dims = list(robot["arm_dim"]), list(robot["ee_dim"])
    if len(arm_dims) != len(ee_dims) or len(arm_dims) not in spec.ARM_PREFIXES:
        raise ValueError(f"arm_dim and ee_dim must have one entry per arm, of one or two; got {arm_dims} and {ee_dims}")
    plural = "" if source_type == _OBS else "s"
    arm_key, ee_key = spec.ACTION_KEYS[action_type]
    for prefix, arm_dim, ee_dim in zip(spec.ARM_PREFIXES[len(arm_dims)], arm_dims, ee_dims):
        yield f"{prefix}{arm_key}{plural}", spec.POSE_DIM if arm_key == spec.State.EE_POSE else arm_dim
        yield f"{prefix}{ee_key}{plural}", ee_dim
