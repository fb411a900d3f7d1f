"""Checks of an environment's observations beyond the schema: dimensions, cameras and units of the robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk
from xpl.nested import format_path

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl import Embodiment
    from xpl.contract import Entry, ObservationDict, State
    from xpl_cli.audit.environments.env_probe import EnvProbe, Offer

_POSES = (sdk.State.EE_POSE, sdk.State.TCP_POSE, sdk.State.DELTA_EE_POSE)
_GRIPPER_TOLERANCE = 0.02  # part of the gripper's range: fingers give a little at their stops


def problems(env_probe: EnvProbe, offer: Offer, obs: ObservationDict) -> Iterator[str]:
    """Yield the problems of an observation, each in one sentence.

    Args:
        env_probe: the environment.
        offer: task, embodiment and action type.
        obs: an observation of environment 0.
    """
    from xpl_cli.standard.validate import validate

    arm = offer.robot.arms[0]
    sizes = {"DOF": arm.dof, "EEF": arm.ee_dim}
    schema_problems = validate(obs, "observation", bindings=sizes)
    yield from (f"{format_path(problem.path) or 'the observation'}: {problem.message}" for problem in schema_problems)
    if schema_problems:
        return
    yield from _labels(env_probe, offer, obs)
    yield from _state(offer, obs.get(sdk.Obs.STATE) or {})
    yield from _vision(env_probe, obs.get(sdk.Obs.VISION) or {})


def _labels(env_probe: EnvProbe, offer: Offer, obs: ObservationDict) -> Iterator[str]:
    if obs.get(sdk.Obs.ENV_IDX) != 0:
        yield f"{sdk.Obs.ENV_IDX} is {obs.get(sdk.Obs.ENV_IDX)!r}, but the only environment is 0"
    if not obs.get(sdk.Obs.INSTRUCTION) and not obs.get(sdk.Obs.INSTRUCTIONS):
        yield f"there is no {sdk.Obs.INSTRUCTION}: a language-conditioned policy needs one"
    frequency = (obs.get(sdk.Obs.ADDITIONAL_INFO) or {}).get(sdk.Obs.FREQUENCY)
    declared = env_probe.manifest.frequency(offer.task)
    if frequency is not None and abs(float(frequency) - declared) > 1e-6 * declared:
        yield f"{sdk.Obs.FREQUENCY} is {frequency:g} Hz, and env.yml declares {declared:g} Hz"


def _state(offer: Offer, state: State) -> Iterator[str]:
    keys = offer.robot.dims(offer.action_type)
    missing = [key for key in keys if key not in state]
    if missing:
        yield f"the state lacks {', '.join(missing)}, which {offer.action_type} control commands"
    foreign = [key for key in state if key in _arm_keys() and not _belongs_to(key, offer.robot)]
    if foreign:
        yield f"the state has {', '.join(foreign)}, and {offer.embodiment} has no such arm"
    for arm in offer.robot.arms:
        yield from _poses(arm.prefix, state)
        opening = state.get(arm.prefix + sdk.State.EE_JOINT_STATE)
        if opening is not None and arm.gripper == "parallel_gripper":
            value = float(np.asarray(opening).reshape(-1)[0])
            if not sdk.GRIPPER_CLOSED - _GRIPPER_TOLERANCE <= value <= sdk.GRIPPER_OPEN + _GRIPPER_TOLERANCE:
                yield f"state.{arm.prefix}{sdk.State.EE_JOINT_STATE} is {value:.3g}: 0 is closed and 1 open"
    for key, value in state.items():
        if not np.isfinite(np.asarray(value, dtype=np.float64)).all():
            yield f"state.{key} holds NaN or infinity"


def _arm_keys() -> set[str]:
    """Return the keys of the standard's state that belong to an arm."""
    named = {value for name, value in vars(sdk.State).items() if name.isupper()}
    return {key for key in named if key != sdk.State.MOBILE}


def _belongs_to(key: str, robot: Embodiment) -> bool:
    """Return whether a key belongs to one of a robot's arms: its prefix is one of the robot's."""
    every = {prefix for prefixes in sdk.ARM_PREFIXES.values() for prefix in prefixes if prefix}
    prefix = next((each for each in every if key.startswith(each)), "")
    return prefix in robot.prefixes


def _poses(prefix: str, state: State) -> Iterator[str]:
    for name in _POSES:
        pose = state.get(prefix + name)
        if pose is None:
            continue
        norm = float(np.linalg.norm(np.asarray(pose, dtype=np.float64)[sdk.POSITION_DIM :]))
        if abs(norm - 1) > sdk.QUATERNION_TOLERANCE:
            yield f"the quaternion of state.{prefix}{name} has length {norm:.4g}, and not 1"


def _vision(env_probe: EnvProbe, vision: Entry) -> Iterator[str]:
    declared = env_probe.manifest.cameras
    for name, camera in vision.items():
        if name not in declared:
            yield f"env.yml does not declare the camera {name}"
            continue
        image = camera.get(sdk.Camera.COLOR)
        if not isinstance(image, np.ndarray) or image.ndim != len(("H", "W", "RGB")):
            yield f"the camera {name} has no image under {sdk.Camera.COLOR}"
            continue
        size = (declared[name] or {}).get("height"), (declared[name] or {}).get("width")
        if None not in size and env_probe.cameras is True and image.shape[:2] != size:
            yield f"the camera {name} has {image.shape[:2]} pixels, and env.yml declares {size}"
    if declared and env_probe.cameras and not vision:
        yield "there are no images, and env.yml declares cameras"
