"""What gym-aloha's cameras see, drawn by dm_control as gym-aloha has it drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl.environment import Setup
from xpl.rendering import RendererMissingError, mujoco_view

_FAST = "fast"


class CameraRenderer:
    """Renders the cameras of a setting.

    Args:
        physics: dm_control's.
        setup: image size; the manifest's by default.
        words: of the setting; "fast" renders without anti-aliasing and shadows.
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
            raise RendererMissingError.of("MuJoCo", error) from error
        return color

    def _view(self, source: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        height, width = self._size or (facts["height"], facts["width"])
        model = self._physics.model
        color = self.drawn(source, height, width)
        return mujoco_view(model, self._physics.data, model.name2id(source, "camera"), color)
