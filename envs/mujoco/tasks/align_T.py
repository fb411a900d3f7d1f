"""Slide a T onto its outline without lifting it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import heading, height, let_go, touched, turned
from ..props import BLUE, Part, add_body, add_outline, draw
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Scene

_T, _GRAY = "T", (0.55, 0.55, 0.57, 1.0)
_HALF_HEIGHT = 0.015
# Frame of the T: between bar and stem, whose far end points along -y.
_BAR, _BAR_AT, _STEM, _STEM_AT = (0.05, 0.0125), (0.0, 0.04), (0.0125, 0.04), (0.0, -0.0125)
_MIDDLE, _SIDE, _AHEAD = (-0.05, 0.05), (0.13, 0.2), (0.22, 0.29)
_YAW, _GOAL_YAW = (-0.5, 0.5), (-0.3, 0.3)
_NEAR, _NEAR_TURN = 0.03, math.radians(20.0)
_THERE, _THERE_TURN = 0.01, math.radians(7.0)
_LIFTED = 0.02  # m: more counts as lifted, and the episode cannot be solved any more


class AlignT(Task):
    """The T lies on a side drawn by the seed, its outline near the middle."""

    objects = (_T,)

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Put T and outline on the table."""
        side = math.copysign(1.0, rng.uniform(-1.0, 1.0))
        self._lifted = False
        self._outline, self._outline_yaw = draw(scene, rng, _MIDDLE, _AHEAD), rng.uniform(*_GOAL_YAW)
        for name, half, center in (("bar_outline", _BAR, _BAR_AT), ("stem_outline", _STEM, _STEM_AT)):
            add_outline(scene, name, (*self._on_goal(center), self._outline_yaw), half, _GRAY)
        parts = [
            Part((*half, _HALF_HEIGHT), (*center, 0.0), 0.03, BLUE)
            for half, center in ((_BAR, _BAR_AT), (_STEM, _STEM_AT))
        ]
        position = draw(scene, rng, _SIDE, _AHEAD) * [side, 1.0]
        self._way = math.dist(position, self._outline)
        self.clear = [position + part * (self._outline - position) for part in (0.25, 0.5, 0.75)]
        add_body(scene, _T, parts, [*position, _HALF_HEIGHT], rng.uniform(*_YAW))

    def reached(self, physics: Physics) -> dict[str, bool]:
        """Slid half of the way; then near its outline; without ever being lifted."""
        self._lifted = self._lifted or height(physics, _T) - _HALF_HEIGHT > _LIFTED
        distance, turn = self._errors(physics)
        halfway = touched(physics, _T) and distance < 0.5 * self._way and not self._lifted
        near = distance < _NEAR and turn < _NEAR_TURN and not self._lifted
        return {"halfway": halfway, "near": self.stages["halfway"] and near}

    def solved(self, physics: Physics) -> bool:
        """On its outline, let go, never lifted."""
        distance, turn = self._errors(physics)
        on_goal = distance < _THERE and turn < _THERE_TURN
        return self.stages["halfway"] and on_goal and not self._lifted and let_go(physics, _T)

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return the T and its outline; `stem` is the middle of the stem in the T's frame."""
        shape = {
            "pose": physics.body_pose(_T),
            "half_size": np.array([_BAR[0], _BAR_AT[1] + _BAR[1], _HALF_HEIGHT]),
            "stem": np.array([[*_STEM_AT, 0.0]]),
        }
        goal = {
            "position": np.array([*self._outline, physics.table_top]),
            "half_size": np.array([_BAR[0], _BAR_AT[1] + _BAR[1]]),
            "yaw": self._outline_yaw,
        }
        return {"objects": {_T: shape}, "goals": {"outline": goal}}

    def _on_goal(self, center: tuple[float, float]) -> tuple[float, float]:
        x, y = center
        c, s = math.cos(self._outline_yaw), math.sin(self._outline_yaw)
        return float(self._outline[0] + c * x - s * y), float(self._outline[1] + s * x + c * y)

    def _errors(self, physics: Physics) -> tuple[float, float]:
        """Return distance (m) and angle to the outline."""
        x, y, _ = physics.position(_T)
        return math.dist((x, y), self._outline), turned(heading(physics, _T), self._outline_yaw)


TASK = AlignT
