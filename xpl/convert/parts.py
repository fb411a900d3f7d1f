"""Parts of a model's vectors: what one arm, gripper, position or rotation is in the model's numbers, and back.

Source: spec/v1/model_io.schema.json#/$defs/part. A part reads its numbers out of a state, and writes those of a
command into the fields of an arm; a position and a rotation of one arm make its pose together.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.convert import rotations
from xpl.convert.errors import ConversionError
from xpl.convert.frames import Frame, side_index
from xpl.observation import ObservationError

if TYPE_CHECKING:
    from xpl.contract import Entry
    from xpl.embodiment import Arm, Embodiment

_UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
_POSITION = slice(0, spec.POSITION_DIM)
_ROTATION = slice(spec.POSITION_DIM, spec.POSE_DIM)

State = Mapping[str, Any]
Numbers = np.ndarray[Any, np.dtype[Any]]


class Part(ABC):
    """One part of a vector.

    Attributes:
        kind: its word in the block.
        label: how findings call it.
        key: key of the standard's state that it is about, "" for fill.
        width: numbers that it has.
        reference: what it is counted from in an action, None if the whole vector says that.
        applied: where a change of pose is applied: fixed, body or numbers.
    """

    kind: str
    key: str = ""
    width: int
    reference: str | None = None
    applied = "fixed"

    def __init__(self, label: str) -> None:
        self.label = label

    @abstractmethod
    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) float64 of a state or an absolute command of the standard."""

    @abstractmethod
    def write(self, values: Numbers) -> Numbers:
        """Return absolute numbers (..., width) as the standard's; what that is depends on the part."""

    def add(self, base: Numbers, change: Numbers) -> Numbers:
        """Return absolute numbers, (width,): a change of `base`."""
        return base + change

    def subtract(self, values: Numbers, base: Numbers) -> Numbers:
        """Return the change that leads from `base` to `values`, (width,)."""
        return values - base


class Joints(Part):
    """Joint angles of an arm, or of a hand; of some joints, where others stand elsewhere in the vector.

    Attributes:
        dof: joints of the whole arm, or hand.
    """

    kind = "joints"

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        is_hand = self.kind == "hand"
        super().__init__(f"{self.kind} {entry['arm']}")
        arm = embodiment.arms[side_index(embodiment, entry["arm"])]
        self.key = arm.prefix + (spec.State.EE_JOINT_STATE if is_hand else spec.State.ARM_JOINT_STATE)
        self.dof = arm.ee_dim if is_hand else arm.dof
        if is_hand and arm.gripper == "parallel_gripper":
            raise ConversionError(f"{embodiment.name} has a parallel gripper there; say gripper, not hand")
        self._order = _order(entry.get("names"), arm, self.dof)
        self.width = len(self._order)
        if self.width < self.dof:
            self.label += f" {', '.join(entry['names'])}"
        self._sign = _column(entry.get("sign"), self.width, 1.0, "sign")
        self._offset = _column(entry.get("offset"), self.width, 0.0, "offset")
        self._scale = np.rad2deg(1.0) if entry.get("unit") == "deg" else 1.0
        self.reference = entry.get("reference")

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        angles = _of(state, self.key, self.dof)[self._order]
        result: Numbers = self._sign * angles * self._scale + self._offset
        return result

    def write(self, values: Numbers) -> Numbers:
        """Return the arm's angles (..., DOF), rad, of absolute numbers (..., width); NaN for joints of other parts."""
        angles: Numbers = self._sign * (values - self._offset) / self._scale
        result = np.full((*angles.shape[:-1], self.dof), np.nan)
        result[..., self._order] = angles
        return result

    @property
    def joints(self) -> list[int]:
        """Places of its joints in the standard's order."""
        return [int(place) for place in self._order]

    @property
    def is_whole(self) -> bool:
        """Whether it has all joints of the arm."""
        return self.width == self.dof


class Gripper(Part):
    """A parallel gripper: its opening, 0 closed and 1 open, between the model's two values."""

    kind = "gripper"

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(f"gripper {entry['arm']}")
        arm = embodiment.arms[side_index(embodiment, entry["arm"])]
        if arm.gripper != "parallel_gripper":
            raise ConversionError(f"{embodiment.name} has a hand there; say hand, not gripper")
        self.key = arm.prefix + spec.State.EE_JOINT_STATE
        self._closed, self._open = np.atleast_1d(np.float64(entry["closed"])), np.atleast_1d(np.float64(entry["open"]))
        if self._closed.shape != self._open.shape:
            raise ConversionError(f"{self._closed.size} values closed and {self._open.size} open; give as many of each")
        if (self._closed == self._open).all():
            raise ConversionError("closed and open are the same; say the model's two values")
        self.width = self._closed.size
        self._threshold = entry.get("threshold")
        self.reference = entry.get("reference", "absolute")

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        opening = _of(state, self.key, 1)
        result: Numbers = self._closed + opening * (self._open - self._closed)
        return result

    def write(self, values: Numbers) -> Numbers:
        """Return absolute numbers (..., width) as the standard's."""
        span = self._open - self._closed
        if self._threshold is not None:
            first = int(np.flatnonzero(span)[0])
            beyond: Numbers = (values[..., first] - self._threshold) * np.sign(span[first]) > 0
            return beyond.astype(np.float64)[..., None]
        # Several fingers: the opening that fits them best.
        opening = ((values - self._closed) * span).sum(-1) / (span * span).sum()
        return np.asarray(opening)[..., None]


class _OfPose(Part):
    """A part of the pose of an arm's point."""

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(f"{self.kind} {entry['arm']}")
        arm = embodiment.arms[side_index(embodiment, entry["arm"])]
        self.key = arm.prefix + spec.State.EE_POSE
        self.frame = Frame(embodiment, entry["arm"], entry.get("point", "flange"), entry.get("frame", "world"))
        self.reference = entry.get("reference")
        self.applied = entry.get("applied", "fixed")


class Position(_OfPose):
    """Where a point of an arm is."""

    kind = "position"
    width = spec.POSITION_DIM

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(entry, embodiment)
        self.unit = _UNITS[entry.get("unit", "m")]

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        return self.frame.encode(_of(state, self.key, spec.POSE_DIM))[_POSITION] * self.unit

    def write(self, values: Numbers) -> Numbers:
        """Return absolute numbers (..., width) as the standard's."""
        return values / self.unit

    def turned(self, change: Numbers, quaternion: Numbers) -> Numbers:
        """Return a change that is given in the moving frame in the fixed one."""
        return rotation.rotate(quaternion, change)


class Rotation(_OfPose):
    """How a point of an arm is turned."""

    kind = "rotation"

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(entry, embodiment)
        self.form: str = entry["form"]
        self._euler = entry.get("euler")
        self.width = rotations.WIDTHS[self.form]
        self._sign = entry.get("sign", "any")
        if self._sign != "any" and not self.form.startswith("quaternion"):
            raise ConversionError(f"sign is for quaternions, the form is {self.form}; leave it out")
        axes = str(self._euler or "").lower()
        if any(one == two for one, two in zip(axes, axes[1:])):
            raise ConversionError(f"euler {self._euler} turns about one axis twice in a row; say such as xyz")

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        quaternion = self.frame.encode(_of(state, self.key, spec.POSE_DIM))[_ROTATION]
        if self._sign == "positive_w" and quaternion[0] < 0:
            quaternion = -quaternion
        return rotations.encode(quaternion, self.form, self._euler)

    @property
    def follows(self) -> bool:
        """Whether the sign of its quaternion is that of the step before."""
        return bool(self._sign == "continuous")

    def scalar(self, values: Numbers) -> float:
        """Return w of a quaternion in its form."""
        return float(values[0 if self.form == "quaternion_wxyz" else -1])

    def write(self, values: Numbers) -> Numbers:
        """Return unit quaternions (..., 4)."""
        try:
            return rotations.decode(values, self.form, self._euler)
        except ConversionError as error:
            raise ConversionError(f"model_io.action, {self.label}: {error}") from None

    def add(self, base: Numbers, change: Numbers) -> Numbers:
        """Return the rotation that a change leads to."""
        if self.applied == "numbers":
            return base + change
        one, by = self.write(base), self.write(change)
        turned = rotation.multiply(one, by) if self.applied == "body" else rotation.multiply(by, one)
        return rotations.encode(turned, self.form, self._euler)

    def subtract(self, values: Numbers, base: Numbers) -> Numbers:
        """Return the change that leads from one rotation to another."""
        if self.applied == "numbers":
            return values - base
        to, back = self.write(values), rotation.conjugate(self.write(base))
        change = rotation.multiply(back, to) if self.applied == "body" else rotation.multiply(to, back)
        return rotations.encode(change, self.form, self._euler)


class Hand(Joints):
    """Joints of a hand."""

    kind = "hand"


class Fill(Part):
    """Numbers that mean nothing."""

    kind = "fill"

    def __init__(self, entry: Entry) -> None:
        super().__init__("fill")
        self.width = entry["width"]
        self.reference = "absolute"
        self._value = entry.get("value", 0.0)

    def read(self, state: State) -> Numbers:
        """Return the numbers; the state has no say."""
        del state
        return np.full(self.width, float(self._value))

    def write(self, values: Numbers) -> Numbers:
        """Return absolute numbers (..., width) as the standard's."""
        return values


_MADE: dict[str, type[Joints | Gripper | Position | Rotation]] = {
    made.kind: made for made in (Joints, Hand, Gripper, Position, Rotation)
}


def part(entry: Entry, embodiment: Embodiment) -> Part:
    """Return a part of a vector from its entry in the block.

    Raises:
        ConversionError: if it does not fit the robot.
    """
    ((kind, how),) = entry.items()
    if kind == "fill":
        return Fill(how)
    try:
        return _MADE[kind](how, embodiment)
    except ConversionError as error:
        raise ConversionError(f"{kind} {how['arm']}: {error}") from None


def check_joints(parts: Sequence[Part]) -> None:
    """Check that the joints of each arm stand in a vector once, in one part or in several.

    Raises:
        ConversionError: if one is left out, or stands there twice.
    """
    found: dict[str, list[Joints]] = {}
    for item in parts:
        if isinstance(item, Joints):
            found.setdefault(item.key, []).append(item)
    for key, several in found.items():
        places = sorted(place for item in several for place in item.joints)
        if not several[0].is_whole and places != list(range(several[0].dof)):
            told = "; ".join(item.label for item in several)
            raise ConversionError(f"expected each joint of {key} once in all parts together; got {told}")


def _order(names: list[str] | None, arm: Arm, width: int) -> Numbers:
    """Return for each of the model's joints its position in the standard's order."""
    if names is None:
        return np.arange(width)
    known = arm.joint_names
    if known is None:
        raise ConversionError("the standard knows no joint names of this arm; leave names out")
    if not set(names) <= set(known):
        raise ConversionError(f"expected joints of the robot, {', '.join(known)}; got {', '.join(names)}")
    return np.array([known.index(name) for name in names])


def _column(values: object, width: int, default: float, word: str) -> Numbers:
    column = np.full(width, default) if values is None else np.asarray(values, np.float64)
    if column.shape != (width,):
        raise ConversionError(f"{word} has {column.size} entries, expected {width}: one for each joint")
    return column


def _of(state: State, key: str, width: int) -> Numbers:
    if key not in state:
        raise ObservationError(f"the state has no {key!r}, which the model_io block reads; it has {', '.join(state)}")
    try:
        given = np.asarray(state[key])
    except ValueError:  # lists of unequal lengths
        raise ObservationError(f"{key} holds lists of unequal lengths, expected {width} numbers") from None
    if given.dtype.kind not in "biuf":  # numpy would read numbers out of texts
        raise ObservationError(f"{key} holds {given.dtype}, expected numbers")
    values = given.astype(np.float64)
    if values.shape != (width,):
        raise ObservationError(f"{key} has shape {values.shape}, expected ({width},)")
    if not np.isfinite(values).all():
        raise ObservationError(f"{key} holds a value that is not finite")
    return values
