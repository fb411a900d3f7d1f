"""Put a square peg into a square hole that is little wider."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import height, held, let_go, off, upright
from ..props import GRAY, YELLOW, Part, add_fixture, draw
from ..scene import Box
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Scene

_PEG = Box("peg", half=(0.011, 0.011, 0.04), mass=0.05, color=YELLOW)
_SOCKET, _CLEARANCE, _WALL, _RIM = "socket", 0.0025, 0.008, 0.02  # m: on each side, half a wall, half its height
_HOLE = _PEG.half[0] + _CLEARANCE
_SIDES = tuple(
    Part(
        (_WALL if dx else _HOLE + 2 * _WALL, _WALL if dy else _HOLE, _RIM),
        (dx * (_HOLE + _WALL), dy * (_HOLE + _WALL), _RIM),
        0.1,
        GRAY,
    )
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
)
_MIDDLE, _SIDE, _AHEAD, _YAW = (-0.04, 0.04), (0.14, 0.22), (0.2, 0.29), (-0.2, 0.2)
_LIFTED, _OVER, _IN, _DEEP = 0.03, 0.01, 0.006, 0.01  # m
_STRAIGHT = math.cos(math.radians(10.0))


class PegInsert(Task):
    """The peg stands on the table; the socket stands in the middle, square to the table."""

    objects = (_PEG.name,)

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Put the socket in the middle and the peg on a side drawn by the seed."""
        side = math.copysign(1.0, rng.uniform(-1.0, 1.0))
        self._hole = draw(scene, rng, _MIDDLE, _AHEAD)
        add_fixture(scene, _SOCKET, _SIDES, [*self._hole, 0.0])
        scene.add_box(_PEG, draw(scene, rng, _SIDE, _AHEAD) * [side, 1.0], rng.uniform(*_YAW))

    def reached(self, physics: Physics) -> dict[str, bool]:
        """Lifted in a gripper; then over the hole in a gripper."""
        lifted = held(physics, _PEG.name) and height(physics, _PEG.name) > _PEG.half[2] + _LIFTED
        return {"lifted": lifted, "over": lifted and off(physics, _PEG.name, self._hole) < _OVER}

    def solved(self, physics: Physics) -> bool:
        """In the hole down to the table, upright, let go."""
        return (
            self.stages["lifted"]
            and off(physics, _PEG.name, self._hole) < _IN
            and height(physics, _PEG.name) < _PEG.half[2] + _DEEP
            and upright(physics, _PEG.name) > _STRAIGHT
            and let_go(physics, _PEG.name)
        )

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return the peg, and the hole at the height of the table."""
        peg = {"pose": physics.body_pose(_PEG.name), "half_size": np.array(_PEG.half)}
        hole = {"position": np.array([*self._hole, physics.table_top]), "half_size": np.array([_HOLE, _HOLE])}
        return {"objects": {_PEG.name: peg}, "goals": {"hole": hole}}


TASK = PegInsert
