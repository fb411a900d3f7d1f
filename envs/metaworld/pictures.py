"""What the cameras of a MuJoCo benchmark see, upright, drawn by one renderer."""

from __future__ import annotations

import os
from collections.abc import Mapping
from ctypes.util import find_library
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.environment import Setup

_VARIABLE = "MUJOCO_GL"
_OPENCV, _HALF_TURN = np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}


class RendererMissingError(RuntimeError):
    """This machine lacks what the environment draws with."""


class Pictures:
    """Draws what the manifest's cameras see.

    Args:
        model: MuJoCo's.
        setup: which size; the manifest's by default.
        is_fast: draw without anti-aliasing and shadows.
    """

    def __init__(self, model: Any, setup: Setup, *, is_fast: bool) -> None:
        self._model, self._cameras = model, setup.manifest.cameras
        self._size = setup.cameras if isinstance(setup.cameras, tuple) else None
        self._renderers: dict[tuple[int, int], Any] = {}
        if is_fast:
            model.vis.quality.offsamples = 0
            model.light_castshadow[:] = 0

    @staticmethod
    def choose_renderer() -> None:
        """Let MuJoCo draw without a screen, unless `MUJOCO_GL` says how; it has to be said before it is imported."""
        for name, library in _LIBRARIES.items():
            if find_library(library):
                os.environ.setdefault(_VARIABLE, name)

    def seen(self, data: Any) -> dict[str, dict[str, Any]]:
        """Return what each camera sees, (H, W, 3) uint8 RGB, and the matrices of the camera as the picture has them.

        Raises:
            RendererMissingError: this machine cannot draw.
        """
        return {name: self._view(data, facts) for name, facts in self._cameras.items()}

    def close(self) -> None:
        """Release what draws."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers = {}

    def _view(self, data: Any, facts: Mapping[str, Any]) -> dict[str, Any]:
        height, width = self._size or (facts["height"], facts["width"])
        renderer = self._renderer(height, width)
        renderer.update_scene(data, camera=facts["source"])
        color = renderer.render()
        camera = self._model.camera(facts["source"]).id
        # MuJoCo's cameras look along -z with y up, the standard's along z with y down.
        turn = _OPENCV @ data.cam_xmat[camera].reshape(3, 3).T
        if facts["turned"]:
            color, turn = np.ascontiguousarray(color[::-1, ::-1]), _HALF_TURN @ turn
        focal = height / 2 / np.tan(np.radians(self._model.cam_fovy[camera]) / 2)
        extrinsics = np.eye(4)
        extrinsics[:3, :3], extrinsics[:3, 3] = turn, -turn @ data.cam_xpos[camera]
        return {
            spec.Camera.COLOR: color,
            spec.Camera.INTRINSIC_MATRIX: np.array(
                [[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]
            ),
            spec.Camera.EXTRINSICS_MATRIX: extrinsics,
        }

    def _renderer(self, height: int, width: int) -> Any:
        if (height, width) not in self._renderers:
            import mujoco

            glob = self._model.vis.global_
            glob.offheight, glob.offwidth = max(glob.offheight, height), max(glob.offwidth, width)
            try:
                self._renderers[height, width] = mujoco.Renderer(self._model, height, width)
            except Exception as error:
                raise RendererMissingError(
                    f"MuJoCo cannot draw here ({type(error).__name__}: {error}); policies without cameras still run"
                ) from error
        return self._renderers[height, width]
