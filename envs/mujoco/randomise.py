"""The setting `randomized`: appearance and positions vary in every episode, while the task stays the same."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from xpl import _spec as spec
from xpl.poses import compose, pose, transform

from .props import Part, add_body

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from .scene import Scene

    _Thing = tuple[NDArray[np.float64], NDArray[np.float64]]

RANDOMIZED = "randomized"
"""Name of the setting; in every other one nothing here happens."""

_HEAD = spec.CAMERAS[1][0]  # the camera that every embodiment has, not mounted on an arm
_STREAM = 1  # keeps these draws apart from the task's, so that a seed's layout is the same in every setting
_SURFACES = ("table", "floor", "wall_back", "wall_front", "wall_left", "wall_right")
# Colors that no instruction names.
_NEUTRAL = ((0.45, 0.3, 0.5), (0.85, 0.5, 0.25), (0.3, 0.55, 0.55), (0.6, 0.6, 0.6), (0.2, 0.2, 0.22), (0.9, 0.9, 0.88))
_SMALL, _HIGH = (0.012, 0.025), (0.012, 0.03)  # m, half sizes
_MASS = 0.05
_TRIES = 200


def rng_of(seed: int) -> np.random.Generator:
    """Return the generator of all that this setting draws in an episode."""
    return np.random.default_rng([seed, _STREAM])


def vary(facts: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return a manifest with another height of the table and another pose of the head camera."""
    ranges = facts[RANDOMIZED]
    scene, cameras = dict(facts["scene"]), dict(facts["cameras"])
    scene["table"] = {**scene["table"], "top": scene["table"]["top"] - rng.uniform(0.0, ranges["table_lower"])}
    head = dict(cameras[_HEAD])
    head["position"] = (np.array(head["position"]) + _within(rng, ranges["camera_shift"], 3)).tolist()
    head["pitch_down_deg"] += _within(rng, ranges["camera_turn_deg"])
    head["yaw_deg"] = head.get("yaw_deg", 0.0) + _within(rng, ranges["camera_turn_deg"])
    cameras[_HEAD] = head
    return {**facts, "scene": scene, "cameras": cameras}


def instruction(entry: Mapping[str, Any], rng: np.random.Generator) -> str:
    """Return one of a task's paraphrases, which the setting `clean` never uses."""
    wordings: list[str] = entry["paraphrases"]
    return wordings[rng.integers(len(wordings))]


def decorate(
    scene: Scene, facts: Mapping[str, Any], rng: np.random.Generator, clear: Iterable[NDArray[np.float64]]
) -> None:
    """Change colors and light, and add clutter behind the task and distractors beside it, once it is laid out.

    Args:
        scene: with all that belongs to the task.
        facts: the environment's manifest.
        rng: the setting's.
        clear: places (2,) that the task needs besides those where its objects are.
    """
    ranges = facts[RANDOMIZED]
    for name in _SURFACES:
        scene.spec.geom(name).rgba = [*_draws(rng, ranges["surface_color"]), 1.0]
    _relight(scene.spec, ranges, rng)
    own, taken = _task_colors(scene), [*_taken(scene), *clear]
    for kind in ("clutter", "distractors"):
        area = ranges[kind]
        for index in range(rng.integers(area["count"][0], area["count"][1] + 1)):
            position = _free_position(rng, area, scene.line, taken)
            if position is not None:
                taken.append(position)
                _add_distractor(scene, f"{kind}_{index}", position, rng)
    table = scene.spec.geom("table")
    for _ in range(_TRIES):
        if all(math.dist(table.rgba[:3], color) >= ranges["table_contrast"] for color in own):
            break
        table.rgba = [*_draws(rng, ranges["surface_color"]), 1.0]


def _relight(model: Any, ranges: Mapping[str, Any], rng: np.random.Generator) -> None:
    light = model.light("light")
    direction = np.array(light.dir) + _within(rng, ranges["light_turn"], 3)
    light.dir = direction / math.sqrt(float(np.sum(direction**2)))
    light.diffuse = np.array(light.diffuse) * _draws(rng, ranges["light_strength"])


def _taken(scene: Scene) -> list[NDArray[np.float64]]:
    """Return where (2,) the task has put markers and the parts of bodies."""
    return [position for position, _ in _distractors(scene)]


def _task_colors(scene: Scene) -> list[NDArray[np.float64]]:
    """Return the colors (3,) of all that belongs to the task."""
    return [color for _, color in _distractors(scene)]


def _distractors(scene: Scene) -> Iterator[_Thing]:
    """Yield place and color of the task's markers and of the parts of its bodies."""
    arms = {f"{names.prefix}base" for names in scene.arms}
    for geom in scene.spec.worldbody.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX and geom.name != "table":
            yield np.array(geom.pos[:2]), np.array(geom.rgba[:3])
    for body in scene.spec.worldbody.bodies:
        if body.parent.name == "world" and body.name not in arms:
            yield from _parts(body, pose(body.pos, body.quat))


def _parts(body: Any, frame: NDArray[np.float64]) -> Iterator[_Thing]:
    """Yield the parts of a body at a pose (7,) in the world, and those of the bodies that hang on it."""
    for part in body.geoms:
        yield transform(frame, part.pos)[:2], np.array(part.rgba[:3])
    for child in body.bodies:
        yield from _parts(child, compose(frame, pose(child.pos, child.quat)))


def _free_position(
    rng: np.random.Generator, area: Mapping[str, Any], start: float, taken: list[NDArray[np.float64]]
) -> NDArray[np.float64] | None:
    """Return a position (2,) of an area that keeps its distance from all objects; None if there is no room."""
    for _ in range(_TRIES):
        position = np.array([rng.uniform(*area["x"]), start + rng.uniform(*area["ahead"])])
        if all(math.dist(position, other) >= area["apart"] for other in taken):
            return position
    return None


def _add_distractor(scene: Scene, name: str, position: NDArray[np.float64], rng: np.random.Generator) -> None:
    """Add a box of a color that no instruction names."""
    length, width, height = rng.uniform(*_SMALL), rng.uniform(*_SMALL), rng.uniform(*_HIGH)
    color = (*_NEUTRAL[rng.integers(len(_NEUTRAL))], 1.0)
    body = Part((length, width, height), (0.0, 0.0, height), _MASS, color)
    add_body(scene, name, [body], [*position, 0.0], rng.uniform(-math.pi, math.pi))


def _draws(rng: np.random.Generator, between: tuple[float, float]) -> NDArray[np.float64]:
    """Return three numbers from a range."""
    return rng.uniform(between[0], between[1], 3)


def _within(rng: np.random.Generator, bound: float, *shape: int) -> Any:
    """Return numbers between -bound and bound: one, or an array of a shape."""
    return rng.uniform(-bound, bound, shape) if shape else float(rng.uniform(-bound, bound))
