"""Stack one block on another."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import height, held, let_go, off
from ..props import GREEN, RED, draw
from ..scene import Box
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Scene

_LOWER = Box("red_block", half=(0.022, 0.022, 0.022), mass=0.06, color=RED)
_UPPER = Box("green_block", half=(0.022, 0.022, 0.022), mass=0.06, color=GREEN)
# The lower block near the middle, the upper one on either side of it.
_MIDDLE, _SIDE, _AHEAD, _YAW = (-0.03, 0.03), (0.13, 0.23), (0.22, 0.3), (-0.4, 0.4)
_LIFTED = 0.05  # m under the upper block
_OVER, _ON = 0.015, 0.006  # m, largest error in x and y, and in height


class StackBlocksTwo(Task):
    """The green block must come to lie on the red one, and stay there without any hand."""

    objects = (_LOWER.name, _UPPER.name)

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Put the lower block in the middle and the upper one on a side drawn by the seed."""
        side = math.copysign(1.0, rng.uniform(-1.0, 1.0))
        scene.add_box(_LOWER, draw(scene, rng, _MIDDLE, _AHEAD), rng.uniform(*_YAW))
        scene.add_box(_UPPER, draw(scene, rng, _SIDE, _AHEAD) * [side, 1.0], rng.uniform(*_YAW))

    def reached(self, physics: Physics) -> dict[str, bool]:
        """Lifted in a gripper; then over the lower block in a gripper."""
        lifted = held(physics, _UPPER.name) and height(physics, _UPPER.name) > _UPPER.half[2] + _LIFTED
        return {"lifted": lifted, "over": lifted and self._error(physics) < _OVER}

    def solved(self, physics: Physics) -> bool:
        """The upper block rests on the lower one, which rests on the table."""
        low = abs(height(physics, _LOWER.name) - _LOWER.half[2]) < _ON
        gap = height(physics, _UPPER.name) - height(physics, _LOWER.name) - _LOWER.half[2] - _UPPER.half[2]
        return (
            self.stages["lifted"]
            and low
            and abs(gap) < _ON
            and self._error(physics) < _OVER
            and let_go(physics, _LOWER.name, _UPPER.name)
        )

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return both blocks."""
        blocks = {
            box.name: {"pose": physics.body_pose(box.name), "half_size": np.array(box.half)} for box in (_LOWER, _UPPER)
        }
        return {"objects": blocks, "goals": {}}

    def _error(self, physics: Physics) -> float:
        return off(physics, _UPPER.name, physics.body_pose(_LOWER.name)[:2])


TASK = StackBlocksTwo
