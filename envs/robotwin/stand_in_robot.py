"""A mock of RoboTwin's own robot, whose description is a download: two arms of boxes, in a folder of assets.

Kinematics, limits and finger travel are those of the standard's `aloha_agilex`; sizes, camera poses and hands are
invented. RoboTwin's tasks without objects of their own run with it. The results show whether code works together, and
are no results of RoboTwin.

Source of the contract: rlinf-robotwin-runtime 0.1.3, robotwin/envs/robot/robot.py, camera/camera.py and assets.py.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np

from xpl import get_embodiment
from xpl.poses import compose, pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROBOT = "aloha_agilex"
MARKER = "STAND_IN_ROBOT"
"""File that marks a folder of assets with the mock robot."""
FOLDERS = ("assets/background_texture", "assets/objects", "assets/embodiments/aloha-agilex")
SIDES = {"left": "fl", "right": "fr"}
"""Arms, and what their links and joints are called in AgileX's description."""

_ROOT = pose([0.0, -0.65, 0.0], [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
"""Pose of the robot in RoboTwin's world, facing +y."""
# Base of the arms on AgileX's platform, m: agilexrobotics/mobile_aloha_sim at 9085f5ed, fl_base_joint. How far the
# arms are apart is in the standard.
_AHEAD, _HIGH = 0.233, 0.7775
_BEHIND_TOOL = 0.12  # m: RoboTwin commands a point so far behind the one between the fingers, along x
_PRESSED = -0.01  # m: where RoboTwin sends a finger that closes, so that it presses
_THICK = 0.03  # m, of an arm
_PALM = ([0.055, 0.11, 0.04], [0.0275, 0.0, 0.0])  # size and centre in the flange, m
_FINGER = [0.075, 0.008, 0.02]  # size, m; its tip reaches a little over the tool's point
_TIP = 0.132  # m along x of the flange
_CLEAR = 0.001  # m from the middle when closed: fingers that touch are a collision to planners
_CAMERA = ("-0.03 0 0.09", "0 0.6 0")  # at the wrist, looking along x and down to the fingers
_HEAD = {
    "name": "head_camera",
    "type": "D435",
    "position": [0.0, -0.45, 1.35],
    "forward": [0.0, 0.6, -0.8],
    "left": [-1.0, 0.0, 0.0],
}


def write(root: Path) -> None:
    """Write a folder of assets with the robot, and with nothing else that RoboTwin would find there.

    Args:
        root: of the assets, as `ROBOTWIN_ASSETS_ROOT` names one; it exists.
    """
    for name in FOLDERS:
        (root / name).mkdir(parents=True, exist_ok=True)
    (root / MARKER).write_text(__doc__ or "", encoding="utf-8")
    own = root / FOLDERS[-1]
    (own / "stand_in.urdf").write_text(urdf(), encoding="utf-8")
    (own / "config.yml").write_text(json.dumps(_config(), indent=2), encoding="utf-8")  # YAML has JSON in it
    for side in SIDES:
        (own / f"curobo_{side}_tmp.yml").write_text("robot_cfg: {}\n", encoding="utf-8")


def base(side: str) -> NDArray[np.float64]:
    """Return the pose (7,) of an arm's base in RoboTwin's world."""
    return compose(_ROOT, _mount(side))


def urdf() -> str:
    """Return the description of both arms: boxes, no meshes."""
    data = get_embodiment(ROBOT).data
    robot = ET.Element("robot", name="stand_in")
    ET.SubElement(robot, "link", name="footprint")
    for side, name in SIDES.items():
        position = _mount(side)[:3]
        _link(robot, f"{name}_base_link", _bar(data["arm"]["joints"][0]["origin"]["xyz"]))
        _joint(robot, f"{name}_base_joint", "fixed", "footprint", f"{name}_base_link", _text(position))
        _arm(robot, name, data)
        _hand(robot, name, data["end_effector"])
        _link(robot, f"{side}_camera")
        _joint(robot, f"{side}_camera_joint", "fixed", f"{name}_link6", f"{side}_camera", *_CAMERA)
    return ET.tostring(robot, encoding="unicode")


def _mount(side: str) -> NDArray[np.float64]:
    """Return the pose of an arm's base in the robot's root."""
    apart = float(get_embodiment(ROBOT).data["mounts"][side]["xyz"][0])
    return pose([_AHEAD, -apart, _HIGH], [1.0, 0.0, 0.0, 0.0])  # the root's +y is the world's -x


def _arm(robot: ET.Element, name: str, data: Mapping[str, Any]) -> None:
    joints = data["arm"]["joints"]
    for number, joint in enumerate(joints, 1):
        following = joints[number]["origin"]["xyz"] if number < len(joints) else None
        _link(robot, f"{name}_link{number}", _PALM if following is None else _bar(following))
        parent = f"{name}_link{number - 1}" if number > 1 else f"{name}_base_link"
        origin = joint["origin"]
        made = _joint(
            robot,
            f"{name}_joint{number}",
            "revolute",
            parent,
            f"{name}_link{number}",
            _text(origin["xyz"]),
            _text(origin["rpy"]),
        )
        ET.SubElement(made, "axis", xyz=_text(joint["axis"]))
        lower, upper = joint["limits"]
        ET.SubElement(
            made,
            "limit",
            lower=str(lower),
            upper=str(upper),
            effort=str(joint["effort"]),
            velocity=str(joint["velocity"]),
        )


def _hand(robot: ET.Element, name: str, effector: Mapping[str, Any]) -> None:
    """Add two fingers, which slide apart."""
    slide, ahead = np.array(effector["slide_axis"]), float(effector["finger_origin"][0])
    closed, opened = effector["finger_range"]
    for number, sign in ((7, 1.0), (8, -1.0)):
        beside = sign * (_CLEAR + _FINGER[1] / 2) * slide
        _link(robot, f"{name}_link{number}", (_FINGER, [_TIP - ahead - _FINGER[0] / 2, *beside[1:].tolist()]))
        made = _joint(
            robot,
            f"{name}_joint{number}",
            "prismatic",
            f"{name}_link6",
            f"{name}_link{number}",
            _text([ahead, 0.0, 0.0]),
        )
        ET.SubElement(made, "axis", xyz=_text(sign * slide))
        ET.SubElement(
            made, "limit", lower=str(closed), upper=str(opened), effort="100", velocity=str(effector["velocity"])
        )


def _bar(end: Sequence[float]) -> tuple[list[float], list[float], list[float]]:
    """Return size, centre and direction (rpy) of a box from a link's origin to a point of it."""
    x, y, z = map(float, end)
    turned = [0.0, -math.atan2(z, math.hypot(x, y)), math.atan2(y, x)]
    return [math.hypot(x, y, z), _THICK, _THICK], [x / 2, y / 2, z / 2], turned


def _link(robot: ET.Element, name: str, box: tuple[list[float], ...] | None = None) -> None:
    link = ET.SubElement(robot, "link", name=name)
    size, centre, *turned = box or ([_THICK] * 3, [0.0] * 3)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value="1")  # which RoboTwin makes all of them
    a, b, c = (side * side for side in size)
    ET.SubElement(
        inertial,
        "inertia",
        ixx=str((b + c) / 12),
        iyy=str((a + c) / 12),
        izz=str((a + b) / 12),
        ixy="0",
        ixz="0",
        iyz="0",
    )
    if box is None:
        return
    for kind in ("visual", "collision"):
        part = ET.SubElement(link, kind)
        ET.SubElement(part, "origin", xyz=_text(centre), rpy=_text(turned[0] if turned else [0.0] * 3))
        ET.SubElement(ET.SubElement(part, "geometry"), "box", size=_text(size))
        if kind == "visual":
            material = ET.SubElement(part, "material", name=f"{name}_grey")
            ET.SubElement(material, "color", rgba="0.35 0.37 0.4 1")


def _joint(  # noqa: PLR0913, PLR0917 - private, in the order of URDF
    robot: ET.Element, name: str, kind: str, parent: str, child: str, xyz: str, rpy: str = "0 0 0"
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _config() -> dict[str, Any]:
    """Return the configuration that RoboTwin reads of a robot: names, drives, pose, cameras."""
    data = get_embodiment(ROBOT).data
    dof = int(data["arm"]["dof"])
    names = [[f"{name}_joint{number}" for number in range(1, dof + 1)] for name in SIDES.values()]
    return {
        "urdf_path": "./stand_in.urdf",
        "planner": "mplib_RRT",
        "dual_arm": True,
        "joint_stiffness": 1000,
        "joint_damping": 200,
        "gripper_stiffness": 1000,
        "gripper_damping": 200,
        "move_group": [f"{name}_link{dof}" for name in SIDES.values()],
        "ee_joints": [arm[-1] for arm in names],
        "arm_joints_name": names,
        "gripper_name": [
            {"base": f"{name}_joint7", "mimic": [[f"{name}_joint8", 1.0, 0.0]]} for name in SIDES.values()
        ],
        "gripper_bias": _BEHIND_TOOL,
        "gripper_scale": [_PRESSED, data["end_effector"]["finger_range"][1]],
        "homestate": [list(data["arm"]["home"])] * 2,
        # The last joint turns about x, and SAPIEN turns its frame by half a turn about that axis: this turns it back.
        "global_trans_matrix": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        "delta_matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "robot_pose": [_ROOT.tolist()],
        "rotate_lim": [0, 1],
        "grasp_perfect_direction": ["front_right", "front_left"],
        "static_camera_list": [_HEAD],
    }


def _text(numbers: Any) -> str:
    return " ".join(str(float(number)) for number in numbers)
