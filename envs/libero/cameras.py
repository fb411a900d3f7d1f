"""What LIBERO's cameras see, in the form that a policy was trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.environment import Setup
from xpl.rendering.robosuite import RobosuiteCameras

_RAW, _ROTATED, _FAST = "raw", "rotated", "fast"


class CameraRenderer(RobosuiteCameras):
    """Renders the cameras of the manifest.

    LIBERO's images are upside down, as OpenGL's are. The standard's are upright. `raw` leaves them as they are, and
    `rotated` turns them by 180 degrees, which mirrors upright images: both only for policies that were trained so.
    Camera matrices are included if images are upright.

    Args:
        setup: image size; the manifest's by default.
        words: of the setting.
    """

    def __init__(self, setup: Setup, words: Sequence[str]) -> None:
        super().__init__(setup.manifest.cameras, asked=setup.cameras, is_fast=_FAST in words)
        self._form = next((word for word in words if word in (_RAW, _ROTATED)), None)

    def seen(self, simulation: Any, obs: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """Return what each camera sees, (H, W, 3) uint8 RGB, and of upright ones the matrices.

        Raises:
            RendererMissingError: this machine cannot draw.
        """
        if self._form is None:
            return super().seen(simulation, obs)
        turned = slice(None, None, -1 if self._form == _ROTATED else 1)
        raw = self.raw(simulation, obs)
        return {name: {spec.Camera.COLOR: np.ascontiguousarray(color[turned, turned])} for name, color in raw.items()}
