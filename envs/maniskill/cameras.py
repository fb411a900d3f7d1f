"""What the cameras of a ManiSkill scene see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from xpl import _spec as spec
from xpl.environment import Setup

_GOAL = "goal"
_ONLY_COLOR = {spec.Camera.DEPTH: False, "position": False, "segmentation": False, "normal": False, "albedo": False}


class CameraRenderer:
    """Renders the cameras of the manifest that the task has, if images are requested.

    Args:
        setup: image size; the manifest's by default, which is ManiSkill's.
        words: of the setting: `goal` renders the markers of goals, which ManiSkill hides from policies.
    """

    def __init__(self, setup: Setup, words: Sequence[str]) -> None:
        self._cameras = setup.manifest.cameras
        self._size = setup.cameras if isinstance(setup.cameras, tuple) else None
        self._shows_goal = _GOAL in words

    def options(self) -> dict[str, Any]:
        """Return what ManiSkill is made with."""
        return {} if self._size is None else {"height": self._size[0], "width": self._size[1]}

    def seen(self, env: Any) -> dict[str, dict[str, Any]]:
        """Return what each camera sees, (H, W, 3) uint8 RGB, and its matrices."""
        for marker in env._hidden_objects:  # noqa: SLF001 - as ManiSkill's own observations do
            if self._shows_goal:
                marker.show_visual()
            else:
                marker.hide_visual()
        env.scene.update_render(update_sensors=True, update_human_render_cameras=False)
        named = {name: env.scene.sensors.get(facts["source"]) for name, facts in self._cameras.items()}
        present = {name: sensor for name, sensor in named.items() if sensor is not None}
        for sensor in present.values():
            sensor.capture()
        return {name: _view(sensor) for name, sensor in present.items()}


def _view(sensor: Any) -> dict[str, Any]:
    matrices = sensor.get_params()
    extrinsics = np.eye(4)
    extrinsics[:3] = matrices["extrinsic_cv"][0].numpy()[:3]
    return {
        spec.Camera.COLOR: np.array(sensor.get_obs(rgb=True, **_ONLY_COLOR)["rgb"][0].numpy()),
        spec.Camera.INTRINSIC_MATRIX: matrices["intrinsic_cv"][0].numpy().astype(np.float64),
        spec.Camera.EXTRINSICS_MATRIX: extrinsics,
    }
