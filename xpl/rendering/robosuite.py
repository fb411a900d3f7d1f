"""Cameras of robosuite, and of benchmarks based on it, such as LIBERO."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from xpl.rendering.errors import RendererMissingError
from xpl.rendering.mujoco import mujoco_view

if TYPE_CHECKING:
    import numpy as np


class RobosuiteCameras:
    """Images of a manifest's cameras; robosuite returns them upside down, as OpenGL does.

    Args:
        cameras: facts by camera of the standard: `source` is robosuite's name, `height` and `width` its size.
        asked: size (H, W) in pixels, True for that of the manifest, False for no images.
        is_fast: render without anti-aliasing.
    """

    def __init__(
        self, cameras: Mapping[str, Mapping[str, Any]], *, asked: tuple[int, int] | bool, is_fast: bool
    ) -> None:
        self._cameras, self._are_wanted, self._is_fast = cameras, bool(asked), is_fast
        first = next(iter(cameras.values()))
        self._size = asked if isinstance(asked, tuple) else (first["height"], first["width"])

    def options(self) -> dict[str, Any]:
        """Return the arguments of robosuite's environment; it renders in each step if images are requested."""
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
        """Make each loaded episode render without anti-aliasing, if `is_fast`."""
        if self._is_fast:
            simulation.set_xml_processor(_without_samples)

    def raw(self, simulation: Any, obs: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Return robosuite's image of each camera, (H, W, 3) uint8 RGB, upside down.

        Raises:
            RendererMissingError: this machine cannot render.
        """
        return {
            name: obs[f"{facts['source']}_image"] if self._are_wanted else self._drawn(simulation, facts["source"])
            for name, facts in self._cameras.items()
        }

    def seen(self, simulation: Any, obs: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """Return the entry of each camera in an observation: its image, upright, and its matrices.

        Raises:
            RendererMissingError: this machine cannot render.
        """
        model, data = simulation.sim.model, simulation.sim.data
        return {
            name: mujoco_view(model, data, model.camera_name2id(self._cameras[name]["source"]), color[::-1])
            for name, color in self.raw(simulation, obs).items()
        }

    def _drawn(self, simulation: Any, source: str) -> np.ndarray:
        """Return an image of a camera that robosuite does not render in each step."""
        from robosuite.utils.binding_utils import MjRenderContextOffscreen

        sim: Any = simulation.sim
        height, width = self._size
        try:
            if sim._render_context_offscreen is None:  # noqa: SLF001 - as robosuite's own code does
                MjRenderContextOffscreen(sim, device_id=-1)
                sim._render_context_offscreen.vopt.geomgroup[0] = 0  # type: ignore[attr-defined]  # noqa: SLF001
            seen: np.ndarray = sim.render(camera_name=source, height=height, width=width)
        except Exception as error:
            raise RendererMissingError.of("MuJoCo", error) from error
        return seen


def _without_samples(xml: str) -> str:
    """Return a model that is rendered without anti-aliasing."""
    if "<quality" in xml:
        return re.sub(r"<quality\b(?![^>]*offsamples)", '<quality offsamples="0"', xml)
    if "<visual>" in xml:
        return xml.replace("<visual>", '<visual><quality offsamples="0"/>', 1)
    return xml.replace("<worldbody>", '<visual><quality offsamples="0"/></visual><worldbody>', 1)
