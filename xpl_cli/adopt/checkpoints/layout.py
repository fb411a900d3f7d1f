"""The parts of a vector (joints, gripper, pose of each arm), by the names of its numbers or by its width.

Names are the dataset's. Where each name is that of a joint, gripper or pose, and the robot has as many, the parts are
`likely`. A vector without names that is as wide as the robot's joints and grippers is taken in the standard's order, as
`assumed`. Everything else stays unknown.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, assumed, likely

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.embodiment import Arm, Embodiment
    from xpl_cli.adopt.checkpoints.reading import ConfigDocument

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
class DataRange:
    """The range of each dimension in the data, with its source."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    evidence: Evidence

    @classmethod
    def read(cls, document: ConfigDocument, path: tuple[str, ...], low: str, high: str) -> DataRange | None:
        """Read a range from a document; None if it is missing, or its ends differ in length.

        Args:
            document: a statistics file.
            path: of the vector's statistics.
            low: key of the minima.
            high: key of the maxima.
        """
        ends = [document.numbers(*path, key) or () for key in (low, high)]
        if not ends[0] or len(ends[0]) != len(ends[1]):
            return None
        what = f"{path[-1]} {low}..{high}"
        return cls(tuple(ends[0]), tuple(ends[1]), Evidence(document.file, document.line(*path, low), what))

    def of(self, first: int, count: int) -> Evidence:
        """Return the range of some dimensions as evidence."""
        pairs = zip(self.low[first : first + count], self.high[first : first + count], strict=True)
        ranges = ", ".join(f"{low:.4g}..{high:.4g}" for low, high in pairs)
        return Evidence(self.evidence.file, self.evidence.line, f"{self.evidence.what}: {ranges}")


@dataclass(frozen=True)
class VectorNumbers:
    """The numbers of a model's vector.

    Attributes:
        width: how many numbers it has.
        evidence: source of the width.
        names: of the numbers; empty if unknown.
        names_evidence: source of the names; None without names.
        range: of the dataset.
    """

    width: int
    evidence: Evidence
    names: Sequence[str] = ()
    names_evidence: Evidence | None = None
    range: DataRange | None = None


@dataclass(frozen=True)
class _NumberName:
    side: str
    kind: str
    word: str


def parts(numbers: VectorNumbers, robot: Embodiment | None, gripper: tuple[float, float] | None = None) -> Tree:
    """Return the parts of a vector.

    Args:
        numbers: the vector.
        robot: the robot; None if unknown.
        gripper: values of the closed and the open gripper, if the user gave them.
    """
    if robot is None:
        return UnknownFact(f"what its {numbers.width} numbers are: the robot is not known", (numbers.evidence,))
    if numbers.names_evidence is not None and len(numbers.names) == numbers.width:
        named_parts = _by_names(numbers, numbers.names_evidence, robot, gripper)
        if named_parts is not None:
            return named_parts
    own = sum(arm.dof + arm.ee_dim for arm in robot.arms)
    if numbers.width == own and not numbers.names:
        return _in_own_order(numbers, robot, gripper)
    expected = "; ".join(
        f"{side}: {arm.dof} joints, {arm.ee_dim} of the {'gripper' if is_gripper(arm) else 'hand'}"
        for side, arm in zip(sides(robot), robot.arms, strict=True)
    )
    evidence = (numbers.evidence, *([numbers.names_evidence] if numbers.names_evidence else []))
    return UnknownFact(f"what its {numbers.width} numbers are ({robot.name} has {expected})", evidence)


def sides(robot: Embodiment) -> list[str]:
    """Return the block's names of a robot's arms."""
    return list(robot.data["arms"])


def is_gripper(arm: Arm) -> bool:
    """Tell whether an arm has a parallel gripper."""
    return arm.gripper == "parallel_gripper"


def _in_own_order(numbers: VectorNumbers, robot: Embodiment, gripper: tuple[float, float] | None) -> Tree:
    result: list[Tree] = []
    order = "the vector is as wide as this robot's joints and grippers, in the standard's order"
    offset = 0
    for side, arm in zip(sides(robot), robot.arms, strict=True):
        joints = {"arm": assumed(side, order), "unit": _unit(numbers, offset, arm)}
        result.append({"joints": joints})
        offset += arm.dof
        if is_gripper(arm):
            result.append({"gripper": {"arm": side, **_gripper_ends(_Slice(numbers, offset, gripper), 1)}})
        else:
            result.append({"hand": {"arm": side, "unit": assumed("rad", "LeRobot and ROS record radians")}})
        offset += arm.ee_dim
    return result


def _by_names(
    numbers: VectorNumbers, names_evidence: Evidence, robot: Embodiment, gripper: tuple[float, float] | None
) -> Tree | None:
    classified = [_classify_name(name, robot) for name in numbers.names]
    result: list[Tree] = []
    offset = 0
    arms = dict(zip(sides(robot), robot.arms, strict=True))
    for (side, kind), group in groupby(classified, key=lambda one: (one.side, one.kind)):
        members = list(group)
        arm = arms.get(side)
        if arm is None or kind == "":
            return None
        names = ", ".join(numbers.names[offset : offset + len(members)])
        where = Evidence(names_evidence.file, names_evidence.line, names)
        part = _part(members, arm, where, _Slice(numbers, offset, gripper))
        if part is None:
            return None
        result.append(part)
        offset += len(members)
    return result


@dataclass(frozen=True)
class _Slice:
    """Numbers of a vector from an index on."""

    numbers: VectorNumbers
    offset: int
    gripper: tuple[float, float] | None


def _part(members: list[_NumberName], arm: Arm, where: Evidence, of: _Slice) -> Tree | None:
    """Return the part for a group of names; None where the arm has no such part."""
    side, kind = members[0].side, members[0].kind
    side_fact = likely(side, where)
    if kind == "joint":
        if len(members) != arm.dof:
            return None
        words = [member.word for member in members]
        by_name = (
            arm.joint_names is not None and sorted(words) == sorted(arm.joint_names) and words != [*arm.joint_names]
        )
        order = {"names": likely(words, where)} if by_name else {}
        return {"joints": {"arm": side_fact, **order, "unit": _unit(of.numbers, of.offset, arm)}}
    if kind == "gripper":
        if not is_gripper(arm) or len(members) > 2:
            return None
        return {"gripper": {"arm": side_fact, **_gripper_ends(of, len(members))}}
    if kind == "hand" and len(members) == arm.ee_dim:
        return {"hand": {"arm": side_fact}}
    return _pose(members, side_fact, where)


def _pose(members: list[_NumberName], side_fact: Fact, where: Evidence) -> Tree | None:
    """Return the position or rotation for a group of names; None if they are neither."""
    kind, words = members[0].kind, [member.word for member in members]
    form: dict[str, Tree]
    if kind == "position" and words == ["x", "y", "z"]:
        return {"position": {"arm": side_fact, **_point()}}
    if kind == "axis_angle" and len(words) == 3:
        form = {"form": likely("axis_angle", where)}
    elif kind == "euler" and sorted(axes := "".join(_AXES[word] for word in words)) == ["x", "y", "z"]:
        reason = f"about fixed axes ({axes}, as URDF's roll, pitch, yaw) or moving ones ({axes.upper()})"
        form = {"form": likely("euler", where), "euler": UnknownFact(reason, (where,))}
    elif kind == "quaternion" and (order := "".join(words)) in ("wxyz", "xyzw"):
        form = {"form": likely(f"quaternion_{order}", where)}
    elif kind == "rot6d" and len(words) == 6:
        form = {"form": UnknownFact("rot6d_rows or rot6d_columns: both are written with six numbers", (where,))}
    else:
        return None
    return {"rotation": {"arm": side_fact, **form, **_point()}}


def _point() -> dict[str, Tree]:
    why = "names of numbers do not state it"
    return {
        "point": UnknownFact(f"flange or tcp: {why}; ask the author of the dataset"),
        "frame": UnknownFact(f"world or base: {why}; ask the author of the dataset"),
    }


def _classify_name(name: str, robot: Embodiment) -> _NumberName:
    """Return side and kind of one name; an empty kind if it matches none."""
    text = _SUFFIX.sub("", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().strip())
    words = re.split(r"[^a-z0-9]+", text)
    named_sides = [_SIDES[word] for word in words if word in _SIDES]
    side = named_sides[0] if named_sides else ""
    if len(robot.arms) == 1:
        side = "single"  # a robot with one arm has no other one to be named
    bare = re.sub(r"^(?:left|right|l|r)_|_(?:left|right|l|r)$", "", "_".join(word for word in words if word))
    for kind, pattern in (
        ("axis_angle", _AXIS_ANGLE),
        ("quaternion", _QUATERNION),
        ("rot6d", _ROT6D),
        ("position", _POSITION),
    ):
        if (match := pattern.search(bare)) is not None:
            return _NumberName(side, kind, match[1])
    if _GRIPPER.search(bare) or _HAND.search(bare):
        return _NumberName(side, "gripper" if is_gripper(robot.arms[0]) else "hand", bare)
    if _JOINT.search(bare):  # before roll, pitch and yaw, which are joints too (wrist_roll)
        return _NumberName(side, "joint", _joint(bare, robot))
    if (match := _EULER.search(bare)) is not None:
        return _NumberName(side, "euler", match[1])
    return _NumberName(side, "", bare)


def _joint(bare: str, robot: Embodiment) -> str:
    """Return the robot's name of a joint that a dataset's name ends with: panda_joint1 is joint1."""
    names = robot.arms[0].joint_names or ()
    return next((name for name in names if bare.replace("_", "").endswith(name.replace("_", ""))), bare)


def _gripper_ends(of: _Slice, count: int) -> dict[str, Tree]:
    """Return the values of the closed and the open gripper."""
    if of.gripper is not None:
        ends = [assumed(value if count == 1 else [value] * count, "given with --gripper") for value in of.gripper]
        return {"closed": ends[0], "open": ends[1]}
    evidence = () if of.numbers.range is None else (of.numbers.range.of(of.offset, count),)
    why = "a range has no direction; --gripper CLOSED,OPEN says both"
    return {
        "closed": UnknownFact(f"the model's value of a closed gripper: {why}", evidence),
        "open": UnknownFact("as closed"),
    }


def _unit(numbers: VectorNumbers, offset: int, arm: Arm) -> Fact | UnknownFact:
    """Return the angle unit of one arm, by the range of the data."""
    if numbers.range is None:
        return assumed("rad", "nothing says degrees")
    low, high = numbers.range.low[offset : offset + arm.dof], numbers.range.high[offset : offset + arm.dof]
    largest = max((abs(value) for value in (*low, *high)), default=0.0)
    where = numbers.range.evidence
    evidence = Evidence(where.file, where.line, f"{where.what} reaches {largest:.4g}")
    if largest > _FULL_TURN + _SLACK:
        if largest > 100.0 + _SLACK:
            return likely("deg", evidence)
        return UnknownFact(
            "deg, or rescaled to -100..100 as LeRobot's SO-100 and SO-101 are: angles are beyond a turn", (evidence,)
        )
    if arm.lower is not None and arm.upper is not None:
        inside = [
            lo >= a - _SLACK and hi <= b + _SLACK for lo, hi, a, b in zip(low, high, arm.lower, arm.upper, strict=True)
        ]
        inside_evidence = Evidence(
            evidence.file,
            evidence.line,
            f"{evidence.what}, {sum(inside)} of {arm.dof} joints inside the robot's limits in rad",
        )
        return likely("rad", inside_evidence)
    return likely("rad", evidence)
