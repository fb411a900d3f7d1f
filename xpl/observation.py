"""Reading observations: state vector, images, instruction, environment index.

Each function raises an error if a field is missing or malformed; none substitutes a default.
Source: spec/v1/observation.schema.json.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.action import ActionError, pack, unpack

if TYPE_CHECKING:
    from xpl.contract import Observation
    from xpl.embodiment import Embodiment


class ObservationError(ValueError):
    """An observation lacks a field, or a field has the wrong shape or type."""


def pack_state(obs: Observation, embodiment: Embodiment, action_type: str) -> np.ndarray:
    """Return proprioception as one vector, in the order of a flat action.

    Args:
        obs: the observation.
        embodiment: the robot.
        action_type: "joint" (joint angles) or "ee" (flange poses).

    Returns:
        (D,) float32: joint angles (rad) or poses (m, unit quaternion, w first), and grippers (0..1), per arm.

    Raises:
        ObservationError: the state, a key or a dimension is missing or wrong, or a value is not finite.
    """
    state = obs.get(spec.Obs.STATE)
    if not isinstance(state, Mapping):
        raise ObservationError(f"the observation has no {spec.Obs.STATE!r} map; it has {_names(obs)}")
    try:
        flat = pack(state, embodiment, action_type, what="state")
    except ActionError as error:
        raise ObservationError(str(error)) from None
    if not np.isfinite(flat).all():
        bad = [key for key, values in unpack(flat, embodiment, action_type).items() if not np.isfinite(values).all()]
        raise ObservationError(f"the state holds NaN or infinity in {', '.join(bad)}: every value must be finite")
    return flat


def get_image(obs: Observation, camera: str) -> np.ndarray:
    """Return the RGB image of a camera, (H, W, 3) uint8, a view of the observation's own data where possible.

    Raises:
        ObservationError: the camera is missing, still encoded, or no RGB image.
    """
    vision = obs.get(spec.Obs.VISION)
    if not isinstance(vision, Mapping) or camera not in vision:
        raise ObservationError(f"the observation has no camera {camera!r}; it has {_names(vision)}")
    image = color_of(vision[camera])
    if image is None:
        raise ObservationError(f"camera {camera!r} has no {spec.Camera.COLOR!r}; it has {_names(vision[camera])}")
    if is_encoded(image):
        raise ObservationError(
            f"camera {camera!r} is still encoded: the serving layer decodes images, an adapter does not"
        )
    array = image if isinstance(image, np.ndarray) else _from_lists(image)
    if array.ndim != 3 or array.shape[2] != spec.COLOR_CHANNELS or array.dtype != np.uint8:
        raise ObservationError(f"camera {camera!r} must be (H, W, 3) uint8 RGB, got {array.shape} {array.dtype}")
    return array


def is_encoded(image: object) -> bool:
    """Return whether a colour entry is an encoded image: bytes, or a one-dimensional uint8 array."""
    return isinstance(image, (bytes, bytearray, memoryview)) or (
        isinstance(image, np.ndarray) and image.ndim == 1 and image.dtype == np.uint8
    )


def color_of(camera: object) -> Any:
    """Return the colour entry of one camera under any of its known keys, or None.

    Keys are `color` and its aliases; the image may also be the camera's entry itself.
    """
    if not isinstance(camera, Mapping):
        return camera
    for key in (spec.Camera.COLOR, *spec.READ_ALIASES[spec.Camera.COLOR]):
        if camera.get(key) is not None:
            return camera[key]
    return None


def get_instruction(obs: Observation, *, required: bool = False) -> str | None:
    """Return the instruction: `instruction`, or the first of `instructions`, or None if the observation has neither.

    Args:
        obs: the observation.
        required: raise if there is none.

    Raises:
        ObservationError: the instruction is no text, or is required and missing.
    """
    value = obs.get(spec.Obs.INSTRUCTION)
    several = obs.get(spec.Obs.INSTRUCTIONS)
    if value is None and several is not None:
        if isinstance(several, str) or not isinstance(several, (Sequence, np.ndarray)):
            raise ObservationError(f"{spec.Obs.INSTRUCTIONS} must be a list of text, got {type(several).__name__}")
        value = several[0] if len(several) else None
    if value is not None and not isinstance(value, str):
        raise ObservationError(f"the instruction must be text, got {type(value).__name__}")
    if value is None and required:
        fields = ", ".join(map(str, obs))
        raise ObservationError(
            f"the observation has no {spec.Obs.INSTRUCTION}, nor {spec.Obs.INSTRUCTIONS}; it has {fields}"
        )
    return value


def offered_inputs(obs: Observation) -> list[str]:
    """Return the inputs in an observation by their names in policy.yml: `state.ee_pose`, `vision.cam_head`."""
    state = obs.get(spec.Obs.STATE) or {}
    prefixes = {prefix for names in spec.ARM_PREFIXES.values() for prefix in names if prefix}
    bare = [next((key[len(prefix) :] for prefix in prefixes if key.startswith(prefix)), key) for key in state]
    inputs = [f"{spec.Obs.STATE}.{key}" for key in dict.fromkeys(bare)]
    inputs += [f"{spec.Obs.VISION}.{camera}" for camera in obs.get(spec.Obs.VISION) or {}]
    inputs += [name for name in (spec.Obs.INSTRUCTION, spec.Obs.PRIVILEGED) if obs.get(name) is not None]
    return inputs


def offered_cameras(obs: Observation) -> dict[str, dict[str, int]]:
    """Return the `width` and `height` of each camera's image in an observation."""
    sizes = {name: camera[spec.Camera.COLOR].shape[:2] for name, camera in (obs.get(spec.Obs.VISION) or {}).items()}
    return {name: {"width": int(width), "height": int(height)} for name, (height, width) in sizes.items()}


def env_indices(observations: Sequence[Observation]) -> list[int]:
    """Return the environment index of each observation of a batch.

    If all observations lack `env_idx`, their position is the index.

    Raises:
        ObservationError: some but not all have an index, an index is repeated, or is not a non-negative integer.
    """
    indices_given = [obs.get(spec.Obs.ENV_IDX) for obs in observations]
    if all(index is None for index in indices_given):
        return list(range(len(indices_given)))
    if any(index is None for index in indices_given):
        raise ObservationError(f"either all observations of a batch carry env_idx or none does, got {indices_given}")
    indices = [env_index(index) for index in indices_given]
    if len(set(indices)) != len(indices):
        raise ObservationError(f"an environment index is repeated in one batch: {indices}")
    return indices


def env_index(value: object) -> int:
    """Return one environment index as an int.

    Raises:
        ObservationError: it is not a non-negative integer.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)) or value < 0:
        raise ObservationError(f"an environment index must be a non-negative integer, got {value!r}")
    return int(value)


def _from_lists(image: object) -> np.ndarray:
    """Return the array of nested lists; integers from 0 to 255 become uint8, nothing else is converted."""
    try:
        array = np.asarray(image)
    except ValueError:
        raise ObservationError("an image given as lists must have rows of equal length") from None
    colour = array.dtype.kind in "iu" and array.size > 0 and array.min() >= 0 and array.max() <= np.iinfo(np.uint8).max
    return array.astype(np.uint8) if colour else array


def _names(value: object) -> str:
    return ", ".join(map(str, value)) or "nothing" if isinstance(value, Mapping) else "nothing"
