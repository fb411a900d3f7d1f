"""Scripted observations that reveal every mistake.

No two environments, steps, arms, joints or cameras look alike; nothing is zero, quaternions are unit but not the
identity, images are asymmetric and have different red, green and blue. Everything follows from the arguments, without
a generator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.embodiment import Arm, Embodiment

SIZE = (48, 64)
FREQUENCY = 25.0
INSTRUCTIONS = (
    "move the red block to the left tray",
    "put the green cup on the shelf",
    "open the drawer with the right hand",
    "push the blue box away",
)


def observation(
    embodiment: Embodiment,
    env: int = 0,
    step: int = 0,
    *,
    cameras: Sequence[str] = (),
    size: tuple[int, int] = SIZE,
) -> dict[str, Any]:
    """Return the observation of one environment at one step.

    Args:
        embodiment: the robot.
        env: environment index; also chooses the instruction.
        step: control step in the episode.
        cameras: further cameras, besides those of the embodiment.
        size: height and width of the images.
    """
    names = dict.fromkeys((*embodiment.cameras, *cameras))
    state: dict[str, Any] = {}
    for side, arm in enumerate(embodiment.arms):
        state.update(_arm_state(arm, side, env, step))
    return {
        spec.Obs.DATA_FORMAT_VERSION: spec.DATA_FORMAT_VERSION,
        spec.Obs.INSTRUCTION: INSTRUCTIONS[env % len(INSTRUCTIONS)],
        spec.Obs.ENV_IDX: env,
        spec.Obs.ADDITIONAL_INFO: {spec.Obs.FREQUENCY: FREQUENCY},
        spec.Obs.VISION: {name: _camera(index, env, step, size) for index, name in enumerate(names)},
        spec.Obs.STATE: state,
    }


def advance(obs: Mapping[str, Any], action: Mapping[str, Any], step: int) -> dict[str, Any]:
    """Return the observation after an action was executed perfectly: commanded values become the state."""
    state = {**obs[spec.Obs.STATE], **{key: np.asarray(value, np.float32) for key, value in action.items()}}
    env = obs[spec.Obs.ENV_IDX]
    vision = {
        name: _camera(index, env, step, camera[spec.Camera.COLOR].shape[:2])
        for index, (name, camera) in enumerate(obs[spec.Obs.VISION].items())
    }
    return {**obs, spec.Obs.STATE: state, spec.Obs.VISION: vision}


def _arm_state(arm: Arm, side: int, env: int, step: int) -> dict[str, np.ndarray]:
    phase = 0.17 + 0.31 * side + 0.073 * env + 0.011 * step
    fractions = 0.3 + 0.4 * _wave(arm.dof, phase)  # of the joint's range, away from its limits
    lower = np.full(arm.dof, -1.0) if arm.lower is None else arm.lower
    upper = np.full(arm.dof, 1.0) if arm.upper is None else arm.upper
    flange = _pose(side, env, step, 0.0)
    return {
        arm.prefix + name: np.asarray(value, np.float32)
        for name, value in {
            spec.State.ARM_JOINT_STATE: lower + fractions * (upper - lower),
            spec.State.EE_JOINT_STATE: 0.2 + 0.5 * _wave(arm.ee_dim, phase + 0.5),
            spec.State.EE_POSE: flange,
            spec.State.TCP_POSE: _pose(side, env, step, 0.1),
            spec.State.DELTA_EE_POSE: np.concatenate(
                [0.001 * (1 + side + _wave(3, phase)), _quaternion(0.02 + 0.01 * side)]
            ),
        }.items()
    }


def _wave(count: int, phase: float) -> np.ndarray:
    """Return `count` different values in 0..1 that vary smoothly with the phase."""
    return np.asarray(0.5 + 0.5 * np.sin(phase + 1.3 * np.arange(count)))


def _pose(side: int, env: int, step: int, ahead: float) -> np.ndarray:
    position = [0.32 - 0.11 * side + 0.002 * step, 0.21 * (1 - 2 * side) + 0.013 * env, 0.24 + 0.05 * side + ahead]
    return np.concatenate([position, _quaternion(0.4 + 0.3 * side + 0.05 * env + 0.01 * step)])


def _quaternion(angle: float) -> np.ndarray:
    """Return a rotation about a fixed, oblique axis as [qw, qx, qy, qz]."""
    axis = np.array([0.36, 0.48, 0.8])
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


def _camera(index: int, env: int, step: int, size: tuple[int, int]) -> dict[str, Any]:
    height, width = size
    rows, columns = np.mgrid[0:height, 0:width]
    red = 60 + 150 * columns / width + 10 * index
    green = 30 + 90 * rows / height + 5 * env
    blue = 20 + 25 * index + 2 * step + 15 * (columns > rows * width / height)
    focal = 0.9 * width
    extrinsics = np.eye(4, dtype=np.float32)
    extrinsics[:3, 3] = [0.1 * (index + 1), -0.2, 0.8]
    return {
        spec.Camera.COLOR: np.clip(np.stack([red, green, blue], axis=-1), 0, 255).astype(np.uint8),
        spec.Camera.DEPTH: np.asarray(0.4 + 0.01 * index + 0.5 * rows / height, np.float32),
        spec.Camera.INTRINSIC_MATRIX: np.array(
            [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]], np.float32
        ),
        spec.Camera.EXTRINSICS_MATRIX: extrinsics,
        spec.Camera.SHAPE: np.array([height, width]),
    }
