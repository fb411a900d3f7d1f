"""What the numbers of a vector are: parts of the standard's arms, by the names of the numbers, or by their count.

Names are the data set's. Where each number's name says joint, gripper or pose, and the robot has as many, the parts
are `likely`. Without names a vector that is as wide as the robot's joints and grippers is taken in the standard's own
order, and says that this is `assumed`. Everything else stays open.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.facts import Evidence, Open, Told, Tree, assumed, likely

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.embodiment import Arm, Embodiment
    from xpl_cli.adopt.checkpoints.reading import Document

_SIDES: Final = {"left": "left", "l": "left", "right": "right", "r": "right"}
_GRIPPER: Final = re.compile(r"grip|finger|jaw|claw")
_HAND: Final = re.compile(r"hand")
_JOINT: Final = re.compile(r"joint|motor|waist|shoulder|elbow|forearm|wrist|axis_?\d|^j\d$|servo|arm_?\d")
_POSITION: Final = re.compile(r"(?:^|_)(?:pos_?)?([xyz])$")
_AXIS_ANGLE: Final = re.compile(r"(?:axis_?angle|rotvec)_?([123012xyz])$")
_EULER: Final = re.compile(r"(?:^|_)(roll|pitch|yaw|rx|ry|rz)$")
_QUATERNION: Final = re.compile(r"(?:^|_)(?:quat_?|q)([wxyz])$")
_ROT6D: Final = re.compile(r"(?:rot_?6d|r6d|rot)_?(\d)$")
_SUFFIX: Final = re.compile(r"[._](?:pos|position|rad|val|value|qpos|angle)$")
_FULL_TURN: Final = 2 * math.pi
_SLACK: Final = 0.2
_AXES: Final = {"roll": "x", "pitch": "y", "yaw": "z", "rx": "x", "ry": "y", "rz": "z"}


@dataclass(frozen=True)
class Range:
    """The least and greatest number of each dimension in the data, and where that stands."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    evidence: Evidence

    @classmethod
    def read(cls, document: Document, path: tuple[str, ...], low: str, high: str) -> Range | None:
        """Return the range whose ends lie at a path of a document; None where they do not, or not as many of each.

        Args:
            document: a file of statistics.
            path: of the vector's statistics.
            low: key of the least numbers.
            high: key of the greatest ones.
        """
        ends = [document.numbers(*path, word) or () for word in (low, high)]
        if not ends[0] or len(ends[0]) != len(ends[1]):
            return None
        what = f"{path[-1]} {low}..{high}"
        return cls(tuple(ends[0]), tuple(ends[1]), Evidence(document.file, document.line(*path, low), what))

    def of(self, first: int, count: int) -> Evidence:
        """Return the range of some dimensions as evidence."""
        pairs = zip(self.low[first : first + count], self.high[first : first + count], strict=True)
        shown = ", ".join(f"{low:.4g}..{high:.4g}" for low, high in pairs)
        return Evidence(self.evidence.file, self.evidence.line, f"{self.evidence.what}: {shown}")


@dataclass(frozen=True)
class Numbers:
    """A vector of the model.

    Attributes:
        width: how many numbers it has.
        evidence: where that stands.
        names: what each is called; empty where nothing says.
        named: where that stands; None where nothing says.
        range: the data's.
    """

    width: int
    evidence: Evidence
    names: Sequence[str] = ()
    named: Evidence | None = None
    range: Range | None = None


@dataclass(frozen=True)
class _Name:
    side: str
    kind: str
    word: str


def parts(numbers: Numbers, robot: Embodiment | None, gripper: tuple[float, float] | None = None) -> Tree:
    """Return the parts of a vector.

    Args:
        numbers: the vector.
        robot: whose it is; None where that is not known.
        gripper: values of a closed and of an open gripper, if the user gave them.
    """
    if robot is None:
        return Open(f"what its {numbers.width} numbers are: the robot is not known", (numbers.evidence,))
    if numbers.named is not None and len(numbers.names) == numbers.width:
        found = _by_names(numbers, numbers.named, robot, gripper)
        if found is not None:
            return found
    own = sum(arm.dof + arm.ee_dim for arm in robot.arms)
    if numbers.width == own and not numbers.names:
        return _in_own_order(numbers, robot, gripper)
    wanted = "; ".join(
        f"{side}: {arm.dof} joints, {arm.ee_dim} of the {'gripper' if is_gripper(arm) else 'hand'}"
        for side, arm in zip(sides(robot), robot.arms, strict=True)
    )
    seen = (numbers.evidence, *([numbers.named] if numbers.named else []))
    return Open(f"what its {numbers.width} numbers are ({robot.name} has {wanted})", seen)


def sides(robot: Embodiment) -> list[str]:
    """Return what the block calls the arms of a robot."""
    return list(robot.data["arms"])


def is_gripper(arm: Arm) -> bool:
    """Tell whether an arm has a parallel gripper."""
    return arm.gripper == "parallel_gripper"


def _in_own_order(numbers: Numbers, robot: Embodiment, gripper: tuple[float, float] | None) -> Tree:
    result: list[Tree] = []
    order = "the vector is as wide as this robot's joints and grippers, in the standard's order"
    place = 0
    for side, arm in zip(sides(robot), robot.arms, strict=True):
        joints = {"arm": assumed(side, order), "unit": _unit(numbers, place, arm)}
        result.append({"joints": joints})
        place += arm.dof
        if is_gripper(arm):
            result.append({"gripper": {"arm": side, **_ends(_Slice(numbers, place, gripper), 1)}})
        else:
            result.append({"hand": {"arm": side, "unit": assumed("rad", "LeRobot and ROS record radians")}})
        place += arm.ee_dim
    return result


def _by_names(numbers: Numbers, named: Evidence, robot: Embodiment, gripper: tuple[float, float] | None) -> Tree | None:
    known = [_meaning(name, robot) for name in numbers.names]
    result: list[Tree] = []
    place = 0
    arms = dict(zip(sides(robot), robot.arms, strict=True))
    for (side, kind), group in groupby(known, key=lambda one: (one.side, one.kind)):
        members = list(group)
        arm = arms.get(side)
        if arm is None or kind == "":
            return None
        names = ", ".join(numbers.names[place : place + len(members)])
        where = Evidence(named.file, named.line, names)
        part = _part(members, arm, where, _Slice(numbers, place, gripper))
        if part is None:
            return None
        result.append(part)
        place += len(members)
    return result


@dataclass(frozen=True)
class _Slice:
    """Numbers of a vector from one place on."""

    numbers: Numbers
    place: int
    gripper: tuple[float, float] | None


def _part(members: list[_Name], arm: Arm, where: Evidence, of: _Slice) -> Tree | None:
    """Return the part that some names mean together; None where they mean none that the arm has."""
    side, kind = members[0].side, members[0].kind
    said = likely(side, where)
    if kind == "joint":
        if len(members) != arm.dof:
            return None
        words = [member.word for member in members]
        by_name = (
            arm.joint_names is not None and sorted(words) == sorted(arm.joint_names) and words != [*arm.joint_names]
        )
        order = {"names": likely(words, where)} if by_name else {}
        return {"joints": {"arm": said, **order, "unit": _unit(of.numbers, of.place, arm)}}
    if kind == "gripper":
        if not is_gripper(arm) or len(members) > 2:
            return None
        return {"gripper": {"arm": said, **_ends(of, len(members))}}
    if kind == "hand" and len(members) == arm.ee_dim:
        return {"hand": {"arm": said}}
    return _pose(members, said, where)


def _pose(members: list[_Name], said: Told, where: Evidence) -> Tree | None:
    """Return the position or rotation that some names mean together; None where they mean none."""
    kind, words = members[0].kind, [member.word for member in members]
    form: dict[str, Tree]
    if kind == "position" and words == ["x", "y", "z"]:
        return {"position": {"arm": said, **_point()}}
    if kind == "axis_angle" and len(words) == 3:
        form = {"form": likely("axis_angle", where)}
    elif kind == "euler" and sorted(axes := "".join(_AXES[word] for word in words)) == ["x", "y", "z"]:
        reason = f"about fixed axes ({axes}, as URDF's roll, pitch, yaw) or moving ones ({axes.upper()})"
        form = {"form": likely("euler", where), "euler": Open(reason, (where,))}
    elif kind == "quaternion" and (order := "".join(words)) in ("wxyz", "xyzw"):
        form = {"form": likely(f"quaternion_{order}", where)}
    elif kind == "rot6d" and len(words) == 6:
        form = {"form": Open("rot6d_rows or rot6d_columns: both are written with six numbers", (where,))}
    else:
        return None
    return {"rotation": {"arm": said, **form, **_point()}}


def _point() -> dict[str, Tree]:
    why = "names of numbers do not say"
    return {
        "point": Open(f"flange or tcp: {why}; whoever recorded the data knows"),
        "frame": Open(f"world or base: {why}; whoever recorded the data knows"),
    }


def _meaning(name: str, robot: Embodiment) -> _Name:
    """Return what one name says; an empty kind where that is nothing."""
    text = _SUFFIX.sub("", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().strip())
    words = re.split(r"[^a-z0-9]+", text)
    said = [_SIDES[word] for word in words if word in _SIDES]
    side = said[0] if said else ""
    if len(robot.arms) == 1:
        side = "single"  # a robot with one arm has no other one to be named
    bare = re.sub(r"^(?:left|right|l|r)_|_(?:left|right|l|r)$", "", "_".join(word for word in words if word))
    for kind, pattern in (
        ("axis_angle", _AXIS_ANGLE),
        ("quaternion", _QUATERNION),
        ("rot6d", _ROT6D),
        ("position", _POSITION),
    ):
        if (found := pattern.search(bare)) is not None:
            return _Name(side, kind, found[1])
    if _GRIPPER.search(bare) or _HAND.search(bare):
        return _Name(side, "gripper" if is_gripper(robot.arms[0]) else "hand", bare)
    if _JOINT.search(bare):  # before roll, pitch and yaw, which are joints too (wrist_roll)
        return _Name(side, "joint", _joint(bare, robot))
    if (found := _EULER.search(bare)) is not None:
        return _Name(side, "euler", found[1])
    return _Name(side, "", bare)


def _joint(bare: str, robot: Embodiment) -> str:
    """Return the robot's own name of a joint where a data set's name ends with it: panda_joint1 is joint1."""
    names = robot.arms[0].joint_names or ()
    return next((name for name in names if bare.replace("_", "").endswith(name.replace("_", ""))), bare)


def _ends(of: _Slice, count: int) -> dict[str, Tree]:
    """Return the values of a closed and an open gripper."""
    if of.gripper is not None:
        ends = [assumed(value if count == 1 else [value] * count, "given with --gripper") for value in of.gripper]
        return {"closed": ends[0], "open": ends[1]}
    seen = () if of.numbers.range is None else (of.numbers.range.of(of.place, count),)
    why = "a range has no direction; --gripper CLOSED,OPEN says both"
    return {"closed": Open(f"the model's value of a closed gripper: {why}", seen), "open": Open("as closed")}


def _unit(numbers: Numbers, place: int, arm: Arm) -> Told | Open:
    """Return the unit of the angles of one arm, by what the data holds."""
    if numbers.range is None:
        return assumed("rad", "nothing says degrees")
    low, high = numbers.range.low[place : place + arm.dof], numbers.range.high[place : place + arm.dof]
    largest = max((abs(value) for value in (*low, *high)), default=0.0)
    where = numbers.range.evidence
    seen = Evidence(where.file, where.line, f"{where.what} reaches {largest:.4g}")
    if largest > _FULL_TURN + _SLACK:
        if largest > 100.0 + _SLACK:
            return likely("deg", seen)
        return Open(
            "deg, or rescaled to -100..100 as LeRobot's SO-100 and SO-101 are: angles are beyond a turn", (seen,)
        )
    if arm.lower is not None and arm.upper is not None:
        inside = [
            lo >= a - _SLACK and hi <= b + _SLACK for lo, hi, a, b in zip(low, high, arm.lower, arm.upper, strict=True)
        ]
        told = Evidence(
            seen.file, seen.line, f"{seen.what}, {sum(inside)} of {arm.dof} joints inside the robot's limits in rad"
        )
        return likely("rad", told)
    return likely("rad", seen)
