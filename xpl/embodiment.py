"""Robots by name: dimensions, joint names, limits, gripper stroke and home pose.

The facts are `spec/robots/*.yml` and, in a project, `embodiments/*.yml`
(`xpl.robots`); what the manufacturer does not publish is None.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import robots
from xpl.nearest import nearest

if TYPE_CHECKING:
    from xpl.contract import Entry
    from xpl.manifest import Manifest


class UnknownEmbodimentError(LookupError):
    """There is no embodiment of this name."""


@dataclass(frozen=True, eq=False)  # there is one object of each robot; arrays have no single truth value
class Arm:
    """One arm and its end effector.

    Attributes:
        prefix: prefix of the arm's keys, "" or "left_" / "right_".
        dof: number of arm joints.
        ee_dim: number of end-effector values (1 for a parallel gripper).
        joint_names: names of the joints, or None.
        lower, upper: joint limits, (dof,) float64, rad, or None.
        velocity: joint speed limits, (dof,) float64, rad/s, or None.
        home: home pose, (dof,) float64, rad, or None.
        gripper: "parallel_gripper" (0 closed, 1 open) or "hand" (radians).
        stroke: opening between the fingers at gripper = 1, m, or None.
    """

    prefix: str
    dof: int
    ee_dim: int
    joint_names: tuple[str, ...] | None
    lower: np.ndarray | None
    upper: np.ndarray | None
    velocity: np.ndarray | None
    home: np.ndarray | None
    gripper: str
    stroke: float | None


@dataclass(frozen=True, eq=False)
class Embodiment:
    """A robot: its arms in packing order; `data` is its whole entry of the spec."""

    name: str
    arms: tuple[Arm, ...]
    data: Mapping[str, Any]

    @property
    def prefixes(self) -> tuple[str, ...]:
        """Prefixes of the arms' keys, in packing order."""
        return tuple(arm.prefix for arm in self.arms)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that an environment of this embodiment is expected to have."""
        return spec.CAMERAS[len(self.arms)]

    def dims(self, action_type: str) -> dict[str, int]:
        """Return the keys of an action step with their dimensions, in packing order.

        Raises:
            ValueError: `action_type` is not one of the standard's.
        """
        return dict(_dims(self, action_type))


@functools.cache
def _dims(embodiment: Embodiment, action_type: str) -> Mapping[str, int]:
    """Return `Embodiment.dims`, cached: each control step calls it more than once."""
    if action_type not in spec.ACTION_KEYS:
        raise ValueError(f"action_type must be one of {', '.join(spec.ACTION_TYPES)}, got {action_type!r}")
    arm_key, ee_key = spec.ACTION_KEYS[action_type]
    result = {}
    for arm in embodiment.arms:
        result[arm.prefix + arm_key] = spec.POSE_DIM if arm_key == spec.State.EE_POSE else arm.dof
        result[arm.prefix + ee_key] = arm.ee_dim
    return result


def embodiment_names() -> list[str]:
    """Return the names of all embodiments, without aliases."""
    return sorted(robots.entries())


def get_embodiment(name: str) -> Embodiment:
    """Return the embodiment `name`, which may be an alias such as `dual_x5`, or a benchmark's name of it.

    Raises:
        UnknownEmbodimentError: lists the nearest names.
    """
    canonical = robots.canonical(name)
    if canonical is not None:
        return _build(canonical)
    near = nearest(str(name), robots.names(), 2, 0.3)
    hint = f"; did you mean {' or '.join(near)}?" if near else ""
    raise UnknownEmbodimentError(f"unknown embodiment {name!r}: known are {', '.join(embodiment_names())}{hint}")


def why_undeclared(manifest: Manifest, embodiment: str, action_type: str) -> str | None:
    """Return why a manifest does not declare a robot and an action type; None if it does, or declares neither.

    Args:
        manifest: policy.yml; may be empty.
        embodiment: name or alias of a robot.
        action_type: "joint" or "ee".
    """
    declared = manifest.embodiments
    if declared and _canonical(embodiment) not in map(_canonical, declared):
        named = f"the embodiments {', '.join(declared)}"
        return f"policy.yml declares {named}, got {spec.Deploy.ENV_CFG_TYPE}: {embodiment}"
    kinds = manifest.action_types
    if kinds and action_type not in kinds:
        named = f"the action types {', '.join(kinds)}"
        return f"policy.yml declares {named}, got {spec.Deploy.ACTION_TYPE}: {action_type}"
    return None


def _canonical(name: str) -> str:
    return robots.canonical(name) or name


_built: dict[str, Embodiment] = {}


def _build(name: str) -> Embodiment:
    """Return the single object of a robot, for any of its aliases."""
    if name not in _built:
        _built[name] = _from_entry(robots.entries()[name])
    return _built[name]


def _from_entry(entry: Entry) -> Embodiment:
    prefixes = spec.ARM_PREFIXES[len(entry["arms"])]
    model, effector = entry["arm"], entry["end_effector"]
    joints = model["joints"] or []
    limits = _column(joints, "limits")
    arms = tuple(
        Arm(
            prefix=prefix,
            dof=model["dof"],
            ee_dim=effector["dim"],
            joint_names=tuple(joint["name"] for joint in joints) or None,
            lower=None if limits is None else limits[:, 0],
            upper=None if limits is None else limits[:, 1],
            velocity=_column(joints, "velocity"),
            home=None if model["home"] is None else _frozen(model["home"]),
            gripper=effector["kind"],
            stroke=effector["stroke"],
        )
        for prefix in prefixes
    )
    return Embodiment(name=entry["name"], arms=arms, data=entry)


def _column(joints: list[dict[str, Any]], key: str) -> np.ndarray | None:
    """Return one property of all joints as an array, or None unless it is known for every joint."""
    values = [joint.get(key) for joint in joints]
    return None if not values or any(value is None for value in values) else _frozen(values)


def _frozen(values: object) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
