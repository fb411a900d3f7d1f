"""Objects beyond a single box: bodies of several boxes, a drawer in its cabinet, and where things are put."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from .scene import GHOST, SOLID, Color, Scene

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

    from .physics import Physics

Vector = tuple[float, float, float]
Range = tuple[float, float]

RED: Color = (0.82, 0.13, 0.1, 1.0)
GREEN: Color = (0.13, 0.55, 0.2, 1.0)
BLUE: Color = (0.12, 0.25, 0.75, 1.0)
YELLOW: Color = (0.9, 0.75, 0.1, 1.0)
GRAY: Color = (0.35, 0.36, 0.4, 1.0)
WOOD: Color = (0.5, 0.34, 0.2, 1.0)

_FRICTION = (1.0, 0.02, 0.001)
_DRAWER_DAMPING, _DRAWER_FRICTION = 3.0, 0.3
_THIN = 0.0005
_TRIES = 1000


@dataclass(frozen=True)
class Part:
    """One box of a body: half its extents and its centre in the body (m), mass (kg) and color."""

    half: Vector
    center: Vector
    mass: float
    color: Color


def add_body(scene: Scene, name: str, parts: Iterable[Part], position: ArrayLike, yaw: float = 0.0) -> None:
    """Add a free body of boxes whose frame is at a place (3,) relative to the table's top, turned about z by `yaw`."""
    body = _frame(scene, name, position, yaw)
    body.add_freejoint(name=name)
    _add_parts(body, parts)


def add_fixture(scene: Scene, name: str, parts: Iterable[Part], position: ArrayLike, yaw: float = 0.0) -> Any:
    """Add a body that does not move; return it."""
    body = _frame(scene, name, position, yaw)
    _add_parts(body, parts)
    return body


def add_drawer(parent: Any, name: str, parts: Iterable[Part], position: Vector, travel: float) -> None:
    """Add a drawer to a fixture; it slides towards the arms (-y) by up to `travel`, m."""
    drawer = parent.add_body(name=name, pos=position)
    drawer.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, -1, 0],
        range=[0, travel],
        limited=True,
        damping=_DRAWER_DAMPING,
        frictionloss=_DRAWER_FRICTION,
    )
    _add_parts(drawer, parts)


def add_outline(scene: Scene, name: str, at: Vector, half: Range, color: Color) -> None:
    """Add a flat rectangle of half size (x, y) on the table, at (x, y, yaw), that is seen and not felt."""
    x, y, yaw = at
    scene.spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[x, y, scene.table_top + _THIN],
        quat=[math.cos(0.5 * yaw), 0, 0, math.sin(0.5 * yaw)],
        size=[*half, _THIN],
        rgba=color,
        **GHOST,
    )


def extension(physics: Physics, name: str) -> float:
    """Return how far a drawer is open, m."""
    return physics.slide(name)


def put(physics: Physics, name: str, place: ArrayLike) -> None:
    """Put a free body upright and at rest at a place (3,) relative to the table's top."""
    joint = physics.model.joint(name)
    position, velocity = joint.qposadr[0], joint.dofadr[0]
    x, y, z = np.asarray(place, dtype=np.float64).tolist()
    physics.data.qpos[position : position + 7] = [x, y, z + physics.table_top, 1.0, 0.0, 0.0, 0.0]
    physics.data.qvel[velocity : velocity + 6] = 0.0
    mujoco.mj_kinematics(physics.model, physics.data)
    mujoco.mj_camlight(physics.model, physics.data)
    physics.changed()


def draw(scene: Scene, rng: np.random.Generator, x: Range, ahead: Range) -> NDArray[np.float64]:
    """Draw a place (2,) on the table: x from its middle, and how far ahead of the scene's line, m."""
    return np.array([rng.uniform(*x), scene.line + rng.uniform(*ahead)])


def draw_apart(
    scene: Scene, rng: np.random.Generator, areas: Iterable[tuple[Range, Range]], gap: float
) -> list[NDArray[np.float64]]:
    """Draw a place in each of some areas (see `draw`), no two of them nearer to each other than `gap`, m.

    Raises:
        ValueError: the areas have no room for that.
    """
    areas = list(areas)
    for _ in range(_TRIES):
        positions = [draw(scene, rng, *area) for area in areas]
        pairs = ((a, b) for index, a in enumerate(positions) for b in positions[:index])
        if all(math.dist(a, b) >= gap for a, b in pairs):
            return positions
    raise ValueError(f"{len(areas)} places at least {gap} m apart do not fit into {areas}")


def _frame(scene: Scene, name: str, position: ArrayLike, yaw: float) -> Any:
    x, y, z = np.asarray(position, dtype=np.float64).tolist()
    half = 0.5 * yaw
    return scene.spec.worldbody.add_body(
        name=name, pos=[x, y, z + scene.table_top], quat=[math.cos(half), 0, 0, math.sin(half)]
    )


def _add_parts(body: Any, parts: Iterable[Part]) -> None:
    for part in parts:
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=part.half,
            pos=part.center,
            mass=part.mass,
            rgba=part.color,
            friction=_FRICTION,
            condim=4,
            **SOLID,
        )
