"""Remember which of the covers hides the red cube, and lift it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import height, held
from ..props import BLUE, GRAY, RED, Part, Range, add_body, draw, put
from ..scene import Box
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Scene

_CUBES, _COVERS = ("cube_1", "cube_2", "cube_3"), ("cover_1", "cover_2", "cover_3")
_CUBE_HALF = 0.015
# A cover's frame is on its underside, in the middle: four walls, a lid, and a knob to grasp.
_WALL, _TALL, _WIDE = 0.003, 0.022, 0.03
_KNOB = Part((0.012, 0.012, 0.02), (0.0, 0.0, 2 * _TALL + 2 * _WALL + 0.02), 0.01, GRAY)
_COVER = (
    *(
        Part(
            (_WALL if dx else _WIDE, _WALL if dy else _WIDE, _TALL),
            (dx * (_WIDE - _WALL), dy * (_WIDE - _WALL), _TALL),
            0.01,
            GRAY,
        )
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ),
    Part((_WIDE, _WIDE, _WALL), (0.0, 0.0, 2 * _TALL + _WALL), 0.02, GRAY),
    _KNOB,
)
_COLUMNS, _SPREAD, _AHEAD = (-0.17, 0.0, 0.17), (-0.02, 0.02), (0.23, 0.31)
_PARKED_AHEAD = 0.55  # m: where the covers stand at first, behind the cubes
_SHOWN = 25  # control steps for which the cubes are to be seen
_CLEAR = 0.12  # m that hands keep from a cube, otherwise its cover waits
_HEIGHT, _WRONG = 0.05, 0.02  # m under the right cover; under another one that count as lifting it


class MemoryCover(Task):
    """Three cubes, one of them red, are seen for a second; then equal covers come over them."""

    objects = (*_CUBES, *_COVERS)

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Put a cube into each column, and the covers in a row behind."""
        red = int(rng.integers(len(_CUBES)))
        self._target, self._wrong, self._steps = _COVERS[red], False, 0
        self._places = [draw(scene, rng, _around(column), _AHEAD) for column in _COLUMNS]
        behind = scene.line + _PARKED_AHEAD
        for index, position in enumerate(self._places):
            cube = Box(_CUBES[index], (_CUBE_HALF,) * 3, 0.03, RED if index == red else BLUE)
            scene.add_box(cube, position, 0.0)
            add_body(scene, _COVERS[index], _COVER, [_COLUMNS[index], behind, 0.0])

    def act(self, physics: Physics) -> None:
        """Cover the cubes once they have been seen and no hand is near."""
        self._steps += 1
        if self.stages["covered"] or self._steps < _SHOWN:
            return
        tips = [physics.tcp(arm)[:3] for arm in range(physics.arm_count)]
        cubes = [physics.body_pose(name)[:3] for name in _CUBES]
        if all(math.dist(tip, cube) > _CLEAR for tip in tips for cube in cubes):
            for cover, cube in zip(_COVERS, cubes, strict=True):
                put(physics, cover, [cube[0], cube[1], 0.0])
            self.stages["covered"] = True

    def reached(self, physics: Physics) -> dict[str, bool]:
        """Covered, which costs nothing but time; then the right cover lifted, and no wrong one before."""
        if self.stages["covered"]:
            wrong = [height(physics, cover) > _WRONG for cover in _COVERS if cover != self._target]
            self._wrong = self._wrong or any(wrong)
        lifted = height(physics, self._target) > _HEIGHT and held(physics, self._target)
        return {
            "covered": self.stages["covered"],
            "lifted": self.stages["covered"] and lifted and not self._wrong,
        }

    def solved(self, physics: Physics) -> bool:
        """The cover of the red cube is up, in a gripper, and no other one ever was."""
        return self.reached(physics)["lifted"]

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return cubes and covers; `target` is the cover to lift, `knob` the middle of a knob in its cover's frame."""
        cubes = {name: {"pose": physics.body_pose(name), "half_size": np.full(3, _CUBE_HALF)} for name in _CUBES}
        covers = {
            name: {
                "pose": physics.body_pose(name),
                "half_size": np.array([_WIDE, _WIDE, _TALL + _WALL]),
                "knob": np.array([_KNOB.center]),
            }
            for name in _COVERS
        }
        return {"objects": {**cubes, **covers}, "goals": {}, "target": self._target, "covered": self.stages["covered"]}


def _around(column: float) -> Range:
    return column + _SPREAD[0], column + _SPREAD[1]


TASK = MemoryCover
