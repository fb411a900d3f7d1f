"""What LIBERO's cameras see, in the form that a policy was trained on."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from ctypes.util import find_library
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.environment import Setup

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_OPENCV = np.diag([1.0, -1.0, -1.0])
_RAW, _ROTATED, _FAST = "raw", "rotated", "fast"


class RendererMissingError(RuntimeError):
    """This machine lacks what the environment draws with."""


def choose_renderer() -> None:
    """Let MuJoCo draw without a screen, unless `MUJOCO_GL` says how; it has to be said before it is imported."""
    for name, library in _LIBRARIES.items():
        if find_library(library):
            os.environ.setdefault("MUJOCO_GL", name)
    os.environ.setdefault("PYOPENGL_PLATFORM", os.environ.get("MUJOCO_GL", "egl"))


class Pictures:
    """Pictures of the manifest's cameras.

    LIBERO gives them upside down, as OpenGL does. The standard's are upright. `raw` leaves them as they are, and
    `rotated` turns them by 180 degrees, which mirrors what is upright: both only for policies that were trained so.
    Matrices of cameras are told where pictures are upright.

    Args:
        setup: which size; the manifest's by default.
        words: of the setting.
    """

    def __init__(self, setup: Setup, words: Sequence[str]) -> None:
        self._cameras, self._are_wanted = setup.manifest.cameras, bool(setup.cameras)
        first = next(iter(self._cameras.values()))
        self._size = setup.cameras if isinstance(setup.cameras, tuple) else (first["height"], first["width"])
        self._form = next((word for word in words if word in (_RAW, _ROTATED)), None)
        self._is_fast = _FAST in words

    def options(self) -> dict[str, Any]:
        """Return what LIBERO is made with: it draws in each step if pictures are wanted."""
        height, width = self._size
        return {
            "has_renderer": False,
            "has_offscreen_renderer": self._are_wanted,
            "use_camera_obs": self._are_wanted,
            "camera_names": [facts["source"] for facts in self._cameras.values()],
            "camera_heights": height,
            "camera_widths": width,
        }

    def prepare(self, simulation: Any) -> None:
        """Let what is loaded for each episode draw fast, if that is wanted."""
        if self._is_fast:
            simulation.set_xml_processor(_without_samples)

    def seen(self, simulation: Any, obs: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """Return what each camera sees, (H, W, 3) uint8 RGB.

        Raises:
            RendererMissingError: this machine cannot draw.
        """
        return {name: self._view(simulation, obs, facts["source"]) for name, facts in self._cameras.items()}

    def _view(self, simulation: Any, obs: Mapping[str, Any], source: str) -> dict[str, Any]:
        height, width = self._size
        raw = obs[f"{source}_image"] if self._are_wanted else self._drawn(simulation, source)
        if self._form == _RAW:
            return {spec.Camera.COLOR: np.ascontiguousarray(raw)}
        if self._form == _ROTATED:
            return {spec.Camera.COLOR: np.ascontiguousarray(raw[::-1, ::-1])}
        model, data = simulation.sim.model, simulation.sim.data
        camera = model.camera_name2id(source)
        # MuJoCo's cameras look along -z with y up, the standard's along z with y down.
        turn = _OPENCV @ data.cam_xmat[camera].reshape(3, 3).T
        focal = height / 2 / np.tan(np.radians(model.cam_fovy[camera]) / 2)
        extrinsics = np.eye(4)
        extrinsics[:3, :3], extrinsics[:3, 3] = turn, -turn @ data.cam_xpos[camera]
        return {
            spec.Camera.COLOR: np.ascontiguousarray(raw[::-1]),
            spec.Camera.INTRINSIC_MATRIX: np.array(
                [[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]
            ),
            spec.Camera.EXTRINSICS_MATRIX: extrinsics,
        }

    def _drawn(self, simulation: Any, source: str) -> np.ndarray:
        """Return a picture for people, where policies want none."""
        from robosuite.utils.binding_utils import MjRenderContextOffscreen

        sim: Any = simulation.sim
        height, width = self._size
        try:
            if sim._render_context_offscreen is None:  # noqa: SLF001 - robosuite's own code asks so
                MjRenderContextOffscreen(sim, device_id=-1)
                sim._render_context_offscreen.vopt.geomgroup[0] = 0  # type: ignore[attr-defined]  # noqa: SLF001
            seen: np.ndarray = sim.render(camera_name=source, height=height, width=width)
        except Exception as error:
            raise RendererMissingError(
                f"MuJoCo cannot draw here ({type(error).__name__}: {error}); policies without cameras still run"
            ) from error
        return seen


def _without_samples(xml: str) -> str:
    """Return a model that is drawn without anti-aliasing."""
    if "<quality" in xml:
        return re.sub(r"<quality\b(?![^>]*offsamples)", '<quality offsamples="0"', xml)
    if "<visual>" in xml:
        return xml.replace("<visual>", '<visual><quality offsamples="0"/>', 1)
    return xml.replace("<worldbody>", '<visual><quality offsamples="0"/></visual><worldbody>', 1)
