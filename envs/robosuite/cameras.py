"""What robosuite's cameras see, upright."""

from __future__ import annotations

from xpl.environment import Setup
from xpl.rendering.robosuite import RobosuiteCameras

_FAST = "fast"


class CameraRenderer(RobosuiteCameras):
    """Renders the manifest's cameras for the number of arms.

    Args:
        setup: which robot and size; the manifest's by default.
    """

    def __init__(self, setup: Setup) -> None:
        arms = len(setup.embodiment.prefixes)
        cameras = {name: facts for name, facts in setup.manifest.cameras.items() if arms in facts["arms"]}
        super().__init__(cameras, asked=setup.cameras, is_fast=setup.setting == _FAST)
