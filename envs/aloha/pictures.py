"""What gym-aloha's cameras see, drawn by dm_control as gym-aloha has it drawn."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from ctypes.util import find_library
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.environment import Setup

_VARIABLE = "MUJOCO_GL"
_OPENCV = np.diag([1.0, -1.0, -1.0])
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_FAST = "fast"


class RendererMissingError(RuntimeError):
    """This machine lacks what the environment draws with."""


def choose_renderer() -> None:
    """Let dm_control draw without a screen, unless `MUJOCO_GL` says how; it has to be said before it is imported."""
    for name, library in _LIBRARIES.items():
        if find_library(library):
            os.environ.setdefault(_VARIABLE, name)


class Pictures:
    """Draws what the cameras of a setting see.

    Args:
        physics: dm_control's.
        setup: which size; the manifest's by default.
        words: of the setting; "fast" draws without anti-aliasing and shadows.
    """

    def __init__(self, physics: Any, setup: Setup, words: Sequence[str]) -> None:
        self._drawn: Mapping[str, str] = setup.manifest.data["drawn"][setup.setting]
        self._cameras = setup.manifest.cameras
        self._size = setup.cameras if isinstance(setup.cameras, tuple) else None
        self._physics = physics
        visual = physics.model.vis
        height, width = self._size or (0, 0)
        visual.global_.offheight = max(visual.global_.offheight, height)
        visual.global_.offwidth = max(visual.global_.offwidth, width)
        if _FAST in words:
            visual.quality.offsamples = 0
            physics.model.light_castshadow[:] = 0

    def seen(self) -> dict[str, dict[str, Any]]:
        """Return what each camera sees, (H, W, 3) uint8 RGB, and the matrices of the camera.

        Raises:
            RendererMissingError: this machine cannot draw.
        """
        return {name: self._view(source, self._cameras[name]) for name, source in self._drawn.items()}

    def drawn(self, source: str, height: int, width: int) -> np.ndarray:
        """Return what a camera of gym-aloha's model sees.

        Raises:
            RendererMissingError: this machine cannot draw.
        """
        try:
            color: np.ndarray = self._physics.render(height=height, width=width, camera_id=source)
        except Exception as error:
            raise RendererMissingError(
                f"MuJoCo cannot draw here ({type(error).__name__}: {error}); policies without cameras still run"
            ) from error
        return color

    def _view(self, source: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        height, width = self._size or (facts["height"], facts["width"])
        model, data = self._physics.model, self._physics.data
        color = self.drawn(source, height, width)
        camera = model.name2id(source, "camera")
        # MuJoCo's cameras look along -z with y up, the standard's along z with y down.
        turn = _OPENCV @ data.cam_xmat[camera].reshape(3, 3).T
        focal = height / 2 / np.tan(np.radians(model.cam_fovy[camera]) / 2)
        extrinsics = np.eye(4)
        extrinsics[:3, :3], extrinsics[:3, 3] = turn, -turn @ data.cam_xpos[camera]
        return {
            spec.Camera.COLOR: color,
            spec.Camera.INTRINSIC_MATRIX: np.array(
                [[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]
            ),
            spec.Camera.EXTRINSICS_MATRIX: extrinsics,
        }
