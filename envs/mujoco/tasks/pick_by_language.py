"""Lift the block that the instruction names by its color."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import height, held
from ..props import BLUE, GREEN, RED, YELLOW, draw_apart
from ..scene import Box, Color
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Scene

_COLORS: dict[str, Color] = {"red": RED, "green": GREEN, "blue": BLUE, "yellow": YELLOW}
_BLOCKS = ("block_1", "block_2", "block_3")
_HALF, _MASS = (0.02, 0.02, 0.02), 0.05
_AREAS = (((-0.22, -0.1), (0.22, 0.32)), ((-0.08, 0.08), (0.22, 0.32)), ((0.1, 0.22), (0.22, 0.32)))
_APART, _YAW = 0.09, (-0.4, 0.4)
_HEIGHT, _WRONG = 0.06, 0.03  # m under the named block; m under another one that count as lifting it


class PickByLanguage(Task):
    """Three blocks that differ in nothing but color; whoever lifts a wrong one has failed."""

    objects = _BLOCKS

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Draw colors and places, and which block is named: no place and no color is named more often."""
        colors = rng.permutation(list(_COLORS))[: len(_BLOCKS)].tolist()
        named = int(rng.integers(len(_BLOCKS)))
        self._named, self._wrong = _BLOCKS[named], False
        self.words = {"hue": colors[named]}
        for name, color, position in zip(_BLOCKS, colors, draw_apart(scene, rng, _AREAS, _APART), strict=True):
            scene.add_box(Box(name, _HALF, _MASS, _COLORS[color]), position, rng.uniform(*_YAW))

    def reached(self, physics: Physics) -> dict[str, bool]:
        """The named block grasped, then lifted, and no other one before."""
        others = [self._bottom(physics, name) > _WRONG for name in _BLOCKS if name != self._named]
        self._wrong = self._wrong or any(others)
        grasped = held(physics, self._named) and not self._wrong
        return {"grasped": grasped, "lifted": grasped and self._bottom(physics, self._named) > _HEIGHT}

    def solved(self, physics: Physics) -> bool:
        """The named block is up, in a gripper, and no other one ever was."""
        return self.reached(physics)["lifted"]

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return the blocks; `target` is the name of the one that is asked for."""
        blocks = {name: {"pose": physics.body_pose(name), "half_size": np.array(_HALF)} for name in _BLOCKS}
        return {"objects": blocks, "goals": {}, "target": self._named}

    def _bottom(self, physics: Physics, name: str) -> float:
        return height(physics, name) - _HALF[2]


TASK = PickByLanguage
