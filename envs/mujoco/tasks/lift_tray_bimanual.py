"""Lift a tray with both hands and keep it level."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import height, upright
from ..props import BLUE, GRAY, Part, add_body, draw
from ..task import Task

if TYPE_CHECKING:
    from ..physics import Physics
    from ..scene import Scene

_TRAY, _FLOOR = "tray", (0.16, 0.06, 0.01)
_HANDLE, _HANDLE_X, _HANDLE_Z = (0.012, 0.012, 0.025), 0.145, 0.035
_PARTS = (
    Part(_FLOOR, (0.0, 0.0, 0.0), 0.15, BLUE),
    Part(_HANDLE, (-_HANDLE_X, 0.0, _HANDLE_Z), 0.02, GRAY),
    Part(_HANDLE, (_HANDLE_X, 0.0, _HANDLE_Z), 0.02, GRAY),
)
_MIDDLE, _AHEAD, _YAW = (-0.03, 0.03), (0.2, 0.27), (-0.1, 0.1)
_HEIGHT, _LEVEL = 0.06, 0.985  # m under the tray; cosine of its tilt (10 degrees)


class LiftTrayBimanual(Task):
    """The tray has a handle at each end; it is too long and heavy for one hand to keep it level."""

    objects = (_TRAY,)

    def lay_out(self, scene: Scene, rng: np.random.Generator) -> None:
        """Put the tray in the middle."""
        add_body(scene, _TRAY, _PARTS, [*draw(scene, rng, _MIDDLE, _AHEAD), _FLOOR[2]], rng.uniform(*_YAW))

    def reached(self, physics: Physics) -> dict[str, bool]:
        """Grasped by both hands; off the table in both."""
        both = all(physics.grasped(_TRAY, arm) for arm in range(physics.arm_count))
        return {"grasped": both, "off_table": both and self._bottom(physics) > 0.5 * _HEIGHT}

    def solved(self, physics: Physics) -> bool:
        """Up, level, in both hands."""
        both = all(physics.grasped(_TRAY, arm) for arm in range(physics.arm_count))
        return both and self._bottom(physics) > _HEIGHT and upright(physics, _TRAY) > _LEVEL

    def truth(self, physics: Physics) -> dict[str, Any]:
        """Return the tray; `handles` are the centres of its handles in its frame."""
        handles = np.array([part.center for part in _PARTS[1:]])
        tray = {"pose": physics.body_pose(_TRAY), "half_size": np.array(_FLOOR), "handles": handles}
        return {"objects": {_TRAY: tray}, "goals": {}}

    def _bottom(self, physics: Physics) -> float:
        return height(physics, _TRAY) - _FLOOR[2]


TASK = LiftTrayBimanual
