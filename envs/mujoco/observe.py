"""Observations of the standard from the state of the physics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl.poses import compose, invert

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from xpl.embodiment import Embodiment

    from .camera import RayCamera
    from .physics import Physics


def flange_poses(physics: Physics) -> list[NDArray[np.float64]]:
    """Return the pose (7,) of every arm's flange in the world."""
    return [physics.flange(arm) for arm in range(physics.arm_count)]


def state(
    physics: Physics, embodiment: Embodiment, previous: list[NDArray[np.float64]]
) -> dict[str, NDArray[np.float32]]:
    """Return the `state` map of an observation.

    Args:
        physics: the scene.
        embodiment: the robot.
        previous: flange poses one control step before; `delta_ee_pose` is the present flange seen from there.
    """
    result: dict[str, NDArray[np.float32]] = {}
    for index, arm in enumerate(embodiment.arms):
        flange = physics.flange(index)
        values = {
            spec.State.ARM_JOINT_STATE: physics.joints(index),
            spec.State.EE_JOINT_STATE: np.array([physics.opening(index)]),
            spec.State.EE_POSE: flange,
            spec.State.TCP_POSE: physics.tcp(index),
            spec.State.DELTA_EE_POSE: compose(invert(previous[index]), flange),
        }
        result.update({arm.prefix + key: value.astype(np.float32) for key, value in values.items()})
    return result


def vision(physics: Physics, cameras: dict[str, RayCamera]) -> dict[str, dict[str, Any]]:
    """Return the `vision` map of an observation; empty without cameras."""
    result = {}
    for name, camera in cameras.items():
        frame = camera.render(physics.data)
        result[name] = {
            spec.Camera.COLOR: frame.color,
            spec.Camera.DEPTH: frame.depth,
            spec.Camera.INTRINSIC_MATRIX: camera.intrinsics.copy(),
            spec.Camera.EXTRINSICS_MATRIX: camera.extrinsics(physics.data),
            spec.Camera.SHAPE: np.array(frame.color.shape),
        }
    return result
