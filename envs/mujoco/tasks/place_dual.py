"""Place two blocks at once, each with the hand on its side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import height, let_go, off
from ..props import BLUE, RED, draw
from ..scene import Box
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Color, Scene

_HALF = (0.018, 0.018, 0.018)
_BLOCKS = (Box("red_block", half=_HALF, mass=0.05, color=RED), Box("blue_block", half=_HALF, mass=0.05, color=BLUE))
_PADS = ("red_pad", "blue_pad")
_PAD_COLORS: tuple[Color, Color] = ((0.85, 0.5, 0.47, 1.0), (0.5, 0.57, 0.85, 1.0))
_PAD_HALF = (0.04, 0.04)
# The blocks lie outside, the pads towards the middle; x is mirrored for the left side.
_OUTSIDE, _INSIDE, _AHEAD, _YAW = (0.2, 0.3), (0.07, 0.12), (0.2, 0.32), (-0.4, 0.4)
_ON_PAD, _ON_TABLE = 0.02, 0.006  # m, largest error in x and y, and in height
_LIFTED = 0.03


class PlaceDual(Task):
    """Each block goes onto the pad of its color; both must be in the air at the same time on the way."""

    objects = tuple(block.name for block in _BLOCKS)

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Put red on the left and blue on the right."""
        self._places = []
        for block, pad, color, side in zip(_BLOCKS, _PADS, _PAD_COLORS, (-1.0, 1.0), strict=True):
            scene.add_box(block, draw(scene, rng, _OUTSIDE, _AHEAD) * [side, 1.0], rng.uniform(*_YAW))
            self._places.append(draw(scene, rng, _INSIDE, _AHEAD) * [side, 1.0])
            scene.add_marker(pad, self._places[-1], _PAD_HALF, color)

    def reached(self, physics: Physics) -> dict[str, bool]:
        """Both lifted at once, each by its hand; then each on its pad."""
        flying = [
            physics.grasped(block.name, arm) and height(physics, block.name) > block.half[2] + _LIFTED
            for arm, block in enumerate(_BLOCKS)
        ]
        red, blue = self._is_placed(physics)
        ready = self.stages["both_lifted"]
        return {"both_lifted": all(flying), "red_placed": ready and red, "blue_placed": ready and blue}

    def solved(self, physics: Physics) -> bool:
        """Both lie on their pads, let go."""
        return self.stages["both_lifted"] and all(self._is_placed(physics)) and let_go(physics, *self.objects)

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return blocks and pads."""
        blocks = {
            block.name: {"pose": physics.body_pose(block.name), "half_size": np.array(block.half)} for block in _BLOCKS
        }
        pads = {
            pad: {"position": np.array([*target, physics.table_top]), "half_size": np.array(_PAD_HALF)}
            for pad, target in zip(_PADS, self._places, strict=True)
        }
        return {"objects": blocks, "goals": pads}

    def _is_placed(self, physics: Physics) -> list[bool]:
        return [
            off(physics, block.name, target) < _ON_PAD
            and abs(height(physics, block.name) - block.half[2]) < _ON_TABLE
            and not physics.touched(block.name, arm)
            for arm, (block, target) in enumerate(zip(_BLOCKS, self._places, strict=True))
        ]


TASK = PlaceDual
