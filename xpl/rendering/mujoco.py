"""Camera images of MuJoCo, with any library that renders them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from ctypes.util import find_library
from typing import Any

import numpy as np

from xpl import _spec as spec

_LIBRARIES: Mapping[str, str] = {"egl": "EGL", "osmesa": "OSMesa"}
_OPENCV = np.diag([1.0, -1.0, -1.0])
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def choose_opengl() -> None:
    """Let MuJoCo render without a display, unless `MUJOCO_GL` is set; call this before any import of MuJoCo."""
    for name, library in _LIBRARIES.items():
        if find_library(library):
            os.environ.setdefault("MUJOCO_GL", name)
    chosen = os.environ.get("MUJOCO_GL", "egl")
    if chosen in _LIBRARIES:
        os.environ.setdefault("PYOPENGL_PLATFORM", chosen)


def mujoco_view(model: Any, data: Any, camera: int, color: np.ndarray, *, half_turn: bool = False) -> dict[str, Any]:
    """Return a camera's entry of an observation: the image, and its intrinsic and extrinsic matrices.

    MuJoCo's cameras look along -z with y up, the standard's along z with y down, as OpenCV's.

    Args:
        model: `mujoco.MjModel`, or a library's wrapper of it; `cam_fovy` is the vertical field of view in degrees.
        data: `mujoco.MjData` or its wrapper, with kinematics up to date.
        camera: id of the camera.
        color: (H, W, 3) uint8 RGB, upright.
        half_turn: rotate the image by 180 degrees, and the camera with it.
    """
    height, width = color.shape[:2]
    turn = _OPENCV @ data.cam_xmat[camera].reshape(3, 3).T
    if half_turn:
        color, turn = color[::-1, ::-1], _HALF_TURN @ turn
    focal = height / 2 / np.tan(np.radians(model.cam_fovy[camera]) / 2)
    extrinsics = np.eye(4)
    extrinsics[:3, :3], extrinsics[:3, 3] = turn, -turn @ data.cam_xpos[camera]
    return {
        spec.Camera.COLOR: np.ascontiguousarray(color),
        spec.Camera.INTRINSIC_MATRIX: np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]),
        spec.Camera.EXTRINSICS_MATRIX: extrinsics,
    }
