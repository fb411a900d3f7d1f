"""An entry: what is known of one robot, in the form of the standard's `embodiment` schema."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec

if TYPE_CHECKING:
    from xpl.contract import Entry

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ARMS = tuple([prefix.rstrip("_") or "single" for prefix in prefixes] for prefixes in spec.ARM_PREFIXES.values())
_KINDS = ("parallel_gripper", "hand")


def inherit(base: Entry, entry: Entry) -> dict[str, Any]:
    """Return an entry with everything besides names and words that it does not say itself from another one."""
    own = {key: value for key, value in entry.items() if key != "like"}
    inherited = {key: value for key, value in base.items() if key not in ("name", "aliases", "description")}
    return _merged(inherited, {"aliases": [], **own})


def has_frames(entry: Entry) -> bool:
    """Tell whether an entry gives the frame, axis and limits of every joint, so that there is kinematics for it."""
    joints = entry["arm"]["joints"]
    return bool(joints) and all(joint.get(key) is not None for joint in joints for key in ("limits", "origin", "axis"))


def faults(robot: object) -> Iterator[str]:
    """Yield what makes an entry none of a robot, as far as code would stumble over it; the tool's schema says more."""
    if not isinstance(robot, Mapping):
        yield f"expected a map that describes a robot, got {type(robot).__name__}"
        return
    arm, effector = robot.get("arm"), robot.get("end_effector")
    aliases = robot.get("aliases") or []
    if not isinstance(aliases, list):
        yield f"aliases must be a list of names, got {aliases!r}"
        return
    words = [robot.get("name"), *aliases]
    bad = [word for word in words if not isinstance(word, str) or not _NAME.fullmatch(word)]
    if bad:
        yield f"names are letters, digits and underscores, got {bad[0]!r}"
    if robot.get("arms") not in _ARMS:
        yield f"arms must be {' or '.join(map(str, _ARMS))}, got {robot.get('arms')!r}"
    if not isinstance(arm, Mapping) or not isinstance(effector, Mapping):
        yield "arm and end_effector describe one arm, and one of them is missing"
        return
    yield from _arm_faults(arm)
    if effector.get("kind") not in _KINDS or not _is_count(effector.get("dim")) or "stroke" not in effector:
        yield f"end_effector needs kind ({' or '.join(_KINDS)}), dim and stroke (m, or null)"


def _arm_faults(arm: Entry) -> Iterator[str]:
    dof, joints, home = arm.get("dof"), arm.get("joints"), arm.get("home")
    if not _is_count(dof):
        yield f"arm.dof must be a whole number of joints, got {dof!r}"
        return
    for key, value in (("joints", joints), ("home", home)):
        if value is not None and (not isinstance(value, list) or len(value) != dof):
            yield f"arm.{key} must be null or a list of {dof}, one for each joint"
    for place, joint in enumerate(joints if isinstance(joints, list) else ()):
        if not isinstance(joint, Mapping) or not {"name", "limits"} <= joint.keys():
            yield f"arm.joints[{place}] needs a name and limits ([from, to] in rad, or null)"


def _merged(base: Entry, own: Entry) -> dict[str, Any]:
    both = (key for key in own if isinstance(base.get(key), Mapping) and isinstance(own[key], Mapping))
    return {**base, **own, **{key: _merged(base[key], own[key]) for key in both}}


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1
