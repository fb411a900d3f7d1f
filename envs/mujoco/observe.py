"""Observations of the standard from the state of the physics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from xpl.embodiment import Embodiment

    from .camera import Camera, Frame
    from .physics import Physics


def state(physics: Physics, embodiment: Embodiment, previous: NDArray[np.float64]) -> dict[str, NDArray[np.float32]]:
    """Return the `state` map of an observation.

    Args:
        physics: the scene.
        embodiment: the robot.
        previous: flange poses (arms, 7) one control step before; `delta_ee_pose` is the present flange seen from there.
    """
    flanges = physics.flanges()
    # All arms at once, because these are small arrays whose cost is the call.
    poses = {
        spec.State.EE_POSE: flanges.astype(np.float32),
        spec.State.TCP_POSE: physics.tcps().astype(np.float32),
        spec.State.DELTA_EE_POSE: _seen_from(previous, flanges).astype(np.float32),
    }
    result: dict[str, NDArray[np.float32]] = {}
    for index, arm in enumerate(embodiment.arms):
        result[arm.prefix + spec.State.ARM_JOINT_STATE] = physics.joints(index).astype(np.float32)
        result[arm.prefix + spec.State.EE_JOINT_STATE] = np.array([physics.opening(index)], dtype=np.float32)
        result.update({arm.prefix + key: values[index].copy() for key, values in poses.items()})
    return result


def _seen_from(frames: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses (n, 7) in as many frames (n, 7), both given in the same one."""
    split = spec.POSITION_DIM
    back = rotation.conjugate(frames[:, split:])
    moved = rotation.rotate(back, poses[:, :split] - frames[:, :split])
    return np.concatenate((moved, rotation.multiply(back, poses[:, split:])), axis=1)


def vision(
    physics: Physics, cameras: Mapping[str, Camera], frames: Mapping[str, Frame]
) -> dict[str, dict[str, NDArray[Any]]]:
    """Return the `vision` map of an observation; empty without cameras."""
    return {
        name: {
            spec.Camera.COLOR: frame.color,
            spec.Camera.DEPTH: frame.depth,
            spec.Camera.INTRINSIC_MATRIX: cameras[name].intrinsics.copy(),
            spec.Camera.EXTRINSICS_MATRIX: cameras[name].extrinsics(physics.data),
            spec.Camera.SHAPE: np.array(frame.color.shape),
        }
        for name, frame in frames.items()
    }


def segmentation(physics: Physics, frames: Mapping[str, Frame]) -> dict[str, Any]:
    """Return the object in every pixel, for privileged observations; empty without cameras.

    Returns:
        ``segmentation``: (H, W) int16 for each camera, index into ``bodies``, the names; 0 is the world, -1 nothing.
    """
    if not frames:
        return {}
    bodies = np.append(physics.model.geom_bodyid, -1).astype(np.int16)  # -1, no geom, is the last
    return {
        "segmentation": {name: bodies[frame.segmentation] for name, frame in frames.items()},
        "bodies": physics.bodies,
    }
