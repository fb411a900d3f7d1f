"""Open a drawer by its handle and put a cube into it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.poses import transform

from ..judge import height, held, let_go
from ..props import RED, WOOD, Part, add_drawer, add_fixture, draw, extension
from ..scene import Box, Color
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Scene

_CUBE = Box("cube", half=(0.016, 0.016, 0.016), mass=0.05, color=RED)
_PALE: Color = (0.8, 0.7, 0.5, 1.0)
_CABINET, _DRAWER, _TRAVEL = "cabinet", "drawer", 0.15
# Frames: of the cabinet on the table under its middle, of the drawer at the middle of its underside.
_WALLS = (
    Part((0.089, 0.09, 0.004), (0.0, 0.0, 0.085), 0.3, WOOD),
    Part((0.004, 0.09, 0.0405), (-0.085, 0.0, 0.0405), 0.2, WOOD),
    Part((0.004, 0.09, 0.0405), (0.085, 0.0, 0.0405), 0.2, WOOD),
    Part((0.089, 0.004, 0.0445), (0.0, 0.094, 0.0445), 0.2, WOOD),
)
_INSIDE = (0.071, 0.076)  # half size of the drawer's inside
_PARTS = (
    Part((0.075, 0.08, 0.003), (0.0, 0.0, 0.003), 0.1, _PALE),
    Part((0.075, 0.004, 0.03), (0.0, -0.08, 0.033), 0.05, _PALE),
    Part((0.075, 0.004, 0.03), (0.0, 0.08, 0.033), 0.05, _PALE),
    Part((0.004, 0.08, 0.03), (-0.071, 0.0, 0.033), 0.05, _PALE),
    Part((0.004, 0.08, 0.03), (0.071, 0.0, 0.033), 0.05, _PALE),
    Part((0.006, 0.016, 0.006), (0.0, -0.1, 0.045), 0.01, WOOD),
    Part((0.012, 0.01, 0.022), (0.0, -0.126, 0.05), 0.02, WOOD),
)
_HANDLE = _PARTS[-1]
_DRAWER_AT = (0.0, -0.005, 0.007)
_CABINET_X, _CABINET_AHEAD = (-0.06, -0.02), (0.44, 0.46)
_CUBE_X, _CUBE_AHEAD, _YAW = (0.12, 0.2), (0.22, 0.3), (-0.3, 0.3)
_OPENED, _STILL_OPEN, _LIFTED = 0.1, 0.07, 0.05  # m
_AT_HANDLE = 0.03  # m between handle and the point between the fingertips
_DEPTH = 0.05  # m over the drawer's underside: below, the cube is in it


class DrawerPlace(Task):
    """A cabinet with a closed drawer on the left, a cube on the right."""

    objects = (_CUBE.name,)

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Put cabinet and cube on the table."""
        position = draw(scene, rng, _CABINET_X, _CABINET_AHEAD)
        cabinet = add_fixture(scene, _CABINET, _WALLS, [*position, 0.0])
        add_drawer(cabinet, _DRAWER, _PARTS, _DRAWER_AT, _TRAVEL)
        scene.add_box(_CUBE, draw(scene, rng, _CUBE_X, _CUBE_AHEAD), rng.uniform(*_YAW))
        handle = position + np.array([_HANDLE.center[0], _HANDLE.center[1] + _DRAWER_AT[1]])
        self.clear = [handle - [0.0, part * _TRAVEL] for part in (0.5, 1.0)]

    def reached(self, physics: Physics) -> dict[str, bool]:
        """Opened by a hand at the handle; the cube lifted after that."""
        opened = extension(physics, _DRAWER) > _OPENED and self._by_handle(physics)
        lifted = held(physics, _CUBE.name) and height(physics, _CUBE.name) > _CUBE.half[2] + _LIFTED
        return {"opened": opened, "lifted": self.stages["opened"] and lifted}

    def solved(self, physics: Physics) -> bool:
        """The cube lies in the open drawer, let go."""
        x, y, z = physics.position_in(_CUBE.name, _DRAWER)
        return (
            self.stages["lifted"]
            and extension(physics, _DRAWER) > _STILL_OPEN
            and abs(x) < _INSIDE[0]
            and abs(y) < _INSIDE[1]
            and z < _DEPTH
            and let_go(physics, _CUBE.name)
        )

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return the cube and the drawer; `handle` and `floor` are points in the drawer's frame."""
        drawer = {
            "pose": physics.body_pose(_DRAWER),
            "half_size": np.array([*_INSIDE, _HANDLE.half[2]]),
            "handle": np.array([_HANDLE.center]),
            "floor": np.array([[0.0, -0.5 * _INSIDE[1], 2 * _PARTS[0].half[2]]]),
            "travel": _TRAVEL,
        }
        cube = {"pose": physics.body_pose(_CUBE.name), "half_size": np.array(_CUBE.half)}
        return {"objects": {_CUBE.name: cube, _DRAWER: drawer}, "goals": {}}

    def _by_handle(self, physics: Physics) -> bool:
        """Return whether a gripper holds the drawer there: one that got caught in it elsewhere does not count."""
        handle = transform(physics.body_pose(_DRAWER), _HANDLE.center)
        arms = range(physics.arm_count)
        return any(
            physics.grasped(_DRAWER, arm) and math.dist(physics.tcp(arm)[:3], handle) < _AT_HANDLE for arm in arms
        )


TASK = DrawerPlace
