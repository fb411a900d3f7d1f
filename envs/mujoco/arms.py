"""Arms of primitive geometry, built with MjSpec from an embodiment's data.

Kinematics, masses, limits and torques are the spec's; shapes are capsules along the links, because no mesh may be
redistributed with every maker's description. Collision geometry is what is drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from xpl import rotation
from xpl.poses import pose

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

_LIGHT, _DARK, _FINGER = (0.9, 0.9, 0.92, 1.0), (0.3, 0.32, 0.36, 1.0), (0.5, 0.53, 0.6, 1.0)
_BASE_RADIUS, _LEAST_BASE_HEIGHT = 0.05, 0.06
_LINK_RADII = (0.042, 0.028)  # from the shoulder to the wrist, evenly
_SHORTEST_CAPSULE = 0.02
_LEAST_MASS = 0.05
_ARMATURE, _DAMPING = 0.02, 0.5
# Stiffness for each N m of torque a joint may exert, 1/rad: full torque at 1/30 rad of error; no joint is stiffer than
# that of 40 N m, which is enough for every load here. A torque of 100 N m is a placeholder in its source.
_STIFFNESS, _STIFFEST, _PLACEHOLDER_TORQUE, _USUAL_TORQUE = 30.0, 40.0, 100.0, 40.0
# Tool, in its own axes (x to the fingertips, y along the slide), from the tcp.
_PALM_CENTER, _PALM_HALF_DEPTH, _PALM_HALF_HEIGHT, _PALM_MASS = -0.085, 0.02, 0.022, 0.2
_FINGER_CENTER, _FINGER_HALF, _FINGER_MASS = -0.03, (0.04, 0.006, 0.012), 0.03
_FINGER_STIFFNESS, _FINGER_FORCE = 1500.0, 15.0  # N/m; N where the spec knows no force
_FINGER_FRICTION, _SKIN_FRICTION = (2.0, 0.1, 0.002), (1.0, 0.05, 0.001)


@dataclass(frozen=True)
class ContactBits:
    """Which geoms may touch: MuJoCo's contype and conaffinity. The links of one arm do not touch each other."""

    own: int
    others: int


@dataclass(frozen=True)
class ArmNames:
    """Names under which the parts of one arm are found in the compiled model, and its tcp (7,) in the flange."""

    prefix: str
    joints: tuple[str, ...]
    gripper: str
    fingers: tuple[str, str]
    flange: str
    tcp: str
    tcp_offset: NDArray[np.float64]


def contact_bits(index: int) -> ContactBits:
    """Return the bits of arm `index`; the world and all objects use bit 1 and touch everything."""
    own = 2 << index
    return ContactBits(own=own, others=7 & ~own)


def add_arm(scene: Any, data: Mapping[str, Any], prefix: str, base: NDArray[np.float64], bits: ContactBits) -> ArmNames:
    """Add one arm with its gripper to a scene.

    Args:
        scene: `mujoco.MjSpec` to add to.
        data: the embodiment's entry in the spec; it must have joint frames and a parallel gripper.
        prefix: of every name, "" or "left_" / "right_".
        base: pose (7,) of the arm's base in the world.
        bits: what the arm may touch.
    """
    skin = {"contype": bits.own, "conaffinity": bits.others, "friction": list(_SKIN_FRICTION), "condim": 4}
    body = scene.worldbody.add_body(name=f"{prefix}base", pos=base[:3], quat=base[3:])
    joints = _nearest_origins(data["arm"]["joints"])
    half = max(_LEAST_BASE_HEIGHT, float(joints[0]["xyz"][2])) / 2  # a column up to the shoulder
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[_BASE_RADIUS, half, 0], pos=[0, 0, half], rgba=_DARK, **skin
    )
    forward = np.array(data["end_effector"]["forward_axis"])
    tips = [np.array(joint["xyz"]) for joint in joints[1:]] + [forward * _reach_to_palm(data)]
    names = []
    for index, (joint, tip) in enumerate(zip(joints, tips, strict=True)):
        names.append(f"{prefix}{joint['name']}")
        body = body.add_body(name=f"{prefix}link{index + 1}", pos=joint["xyz"], quat=joint["quat"], gravcomp=1)
        _add_joint(scene, body, names[-1], joint)
        share = index / max(1, len(joints) - 1)
        radius = _LINK_RADII[0] + share * (_LINK_RADII[1] - _LINK_RADII[0])
        mass, color = max(joint["mass"] or 0.0, _LEAST_MASS), _DARK if index % 2 else _LIGHT
        body.add_geom(mass=mass, rgba=color, **_link_shape(tip, radius), **skin)
    body.add_site(name=f"{prefix}flange", size=[0.005])
    fingers = _add_gripper(scene, body, data["end_effector"], prefix, skin)
    return ArmNames(
        prefix=prefix,
        joints=tuple(names),
        gripper=f"{prefix}gripper",
        fingers=fingers,
        flange=f"{prefix}flange",
        tcp=f"{prefix}tcp",
        tcp_offset=pose(data["end_effector"]["tcp"]["xyz"], rotation.from_rpy(data["end_effector"]["tcp"]["rpy"])),
    )


def tool_rotation(effector: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the quaternion (4,) of the tool's axes in the flange: x to the fingertips, y along the fingers' slide."""
    forward, slide = np.array(effector["forward_axis"]), np.array(effector["slide_axis"])
    return rotation.from_matrix(np.stack([forward, slide, np.cross(forward, slide)], axis=-1))


def _reach_to_palm(data: Mapping[str, Any]) -> float:
    """Return the distance from the flange to the palm along the tool."""
    effector = data["end_effector"]
    return float(np.dot(effector["tcp"]["xyz"], effector["forward_axis"])) + _PALM_CENTER


def _nearest_origins(entries: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the joints with each frame slid along its own axis where that brings it nearer to its neighbours.

    A joint's frame may lie anywhere on its axis; some descriptions put it off the link (X5: joint5, by 82.5 mm, and
    joint6 back again). Sliding changes neither axes nor the flange, only where the link is drawn and has its mass.
    """
    joints = [
        {**entry, "xyz": np.array(entry["origin"]["xyz"]), "quat": rotation.from_rpy(entry["origin"]["rpy"])}
        for entry in entries
    ]
    for joint, following in pairwise(joints):
        axis = np.array(joint["axis"])
        along = float(axis @ following["xyz"])
        slid, shortened = joint["xyz"] + along * rotation.rotate(joint["quat"], axis), following["xyz"] - along * axis
        if math.hypot(*slid) + math.hypot(*shortened) < math.hypot(*joint["xyz"]) + math.hypot(*following["xyz"]):
            joint["xyz"], following["xyz"] = slid, shortened
    return joints


def _add_joint(scene: Any, body: Any, name: str, joint: Mapping[str, Any]) -> None:
    limits = joint["limits"]
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=joint["axis"],
        range=limits,
        limited=True,
        armature=_ARMATURE,
        damping=_DAMPING,
    )
    is_limited = joint["effort"] is not None and joint["effort"] < _PLACEHOLDER_TORQUE
    torque = joint["effort"] if is_limited else _USUAL_TORQUE
    actuator = scene.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        forcerange=[-torque, torque],
        forcelimited=True,
    )
    _follow(actuator, _STIFFNESS * min(torque, _STIFFEST), limits)


def _link_shape(tip: NDArray[np.float64], radius: float) -> dict[str, Any]:
    """Return a capsule from the joint to where the next one is, or a ball where they coincide."""
    if math.hypot(*tip) > _SHORTEST_CAPSULE:
        return {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "fromto": [0, 0, 0, *tip], "size": [radius, 0, 0]}
    return {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [1.15 * radius, 0, 0]}


def _add_gripper(
    scene: Any, flange: Any, effector: Mapping[str, Any], prefix: str, skin: Mapping[str, Any]
) -> tuple[str, str]:
    travel = effector["finger_range"][1]
    tool = flange.add_body(name=f"{prefix}tool", pos=effector["tcp"]["xyz"], quat=tool_rotation(effector), gravcomp=1)
    tool.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[_PALM_CENTER, 0, 0],
        size=[_PALM_HALF_DEPTH, travel + 2 * _FINGER_HALF[1], _PALM_HALF_HEIGHT],
        mass=_PALM_MASS,
        rgba=_DARK,
        **skin,
    )
    # The tcp's rotation is given in the flange: undo the turn of the tool first.
    tcp = rotation.multiply(rotation.conjugate(tool_rotation(effector)), rotation.from_rpy(effector["tcp"]["rpy"]))
    tool.add_site(name=f"{prefix}tcp", size=[0.005], quat=tcp)
    names = (f"{prefix}finger_left", f"{prefix}finger_right")
    for name, sign in zip(names, (1, -1), strict=True):
        finger = tool.add_body(name=name, pos=[_FINGER_CENTER, sign * _FINGER_HALF[1], 0], gravcomp=1)
        finger.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0, sign, 0],
            range=[0, travel],
            limited=True,
            armature=0.05,
            damping=5.0,
        )
        # Priority makes the fingers' friction and stiffness count, whatever they hold.
        finger.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=list(_FINGER_HALF),
            mass=_FINGER_MASS,
            rgba=_FINGER,
            priority=1,
            solref=[0.004, 1],
            **{**skin, "friction": list(_FINGER_FRICTION)},
        )
    scene.add_equality(
        name=f"{prefix}mimic",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=names[0],
        name2=names[1],
        data=[0.0, 1.0] + [0.0] * (mujoco.mjNEQDATA - 2),
        solref=[0.005, 1],
    )
    # One actuator drives both fingers, each with the force that the spec gives for one.
    force = 2 * (effector["effort"] or _FINGER_FORCE)
    actuator = scene.add_actuator(
        name=f"{prefix}gripper",
        target=names[0],
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        forcerange=[-force, force],
        forcelimited=True,
    )
    _follow(actuator, _FINGER_STIFFNESS, [0.0, travel])
    return names


def _follow(actuator: Any, stiffness: float, limits: Sequence[float]) -> None:
    """Let an actuator pull its joint to a target within limits; what is commanded is the speed of that target."""
    actuator.set_to_intvelocity(kp=stiffness, dampratio=1.0)
    actuator.actrange, actuator.actlimited = limits, True
