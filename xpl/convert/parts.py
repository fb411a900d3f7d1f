"""Parts of a model's vectors: what one arm, gripper, position or rotation is in the model's numbers, and back.

Source: spec/v1/model_io.schema.json#/$defs/part. A part reads its numbers out of a state, and writes those of a
command into the fields of an arm; a position and a rotation of one arm make its pose together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.catalogue import convention as catalogue
from xpl.catalogue.part import Numbers, Part, State, arm_of, of
from xpl.conventions import rotation as forms
from xpl.conventions.frame import UNITS
from xpl.convert.frames import Frame
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from xpl.contract import Entry
    from xpl.embodiment import Embodiment

_POSITION = slice(0, spec.POSITION_DIM)
_ROTATION = slice(spec.POSITION_DIM, spec.POSE_DIM)


class _OfPose(Part):
    """A part of the pose of an arm's point."""

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(f"{self.kind} {entry['arm']}")
        arm = arm_of(embodiment, entry["arm"])
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
        self.unit = UNITS[entry.get("unit", "m")]

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        return self.frame.encode(of(state, self.key, spec.POSE_DIM))[_POSITION] * self.unit

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
        self.width = forms.WIDTHS[self.form]
        self._sign = entry.get("sign", "any")
        if self._sign != "any" and not self.form.startswith("quaternion"):
            raise ConversionError(f"sign is for quaternions, the form is {self.form}; leave it out")
        axes = str(self._euler or "").lower()
        if any(one == two for one, two in zip(axes, axes[1:])):
            raise ConversionError(f"euler {self._euler} turns about one axis twice in a row; say such as xyz")

    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) of a state."""
        quaternion = self.frame.encode(of(state, self.key, spec.POSE_DIM))[_ROTATION]
        if self._sign == "positive_w" and quaternion[0] < 0:
            quaternion = -quaternion
        return forms.encode(quaternion, self.form, self._euler)

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
            return forms.decode(values, self.form, self._euler)
        except ConversionError as error:
            raise ConversionError(f"model_io.action, {self.label}: {error}") from None

    def add(self, base: Numbers, change: Numbers) -> Numbers:
        """Return the rotation that a change leads to."""
        if self.applied == "numbers":
            return base + change
        one, by = self.write(base), self.write(change)
        turned = rotation.multiply(one, by) if self.applied == "body" else rotation.multiply(by, one)
        return forms.encode(turned, self.form, self._euler)

    def subtract(self, values: Numbers, base: Numbers) -> Numbers:
        """Return the change that leads from one rotation to another."""
        if self.applied == "numbers":
            return values - base
        to, back = self.write(values), rotation.conjugate(self.write(base))
        change = rotation.multiply(back, to) if self.applied == "body" else rotation.multiply(to, back)
        return forms.encode(change, self.form, self._euler)


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


_MADE: dict[str, type[Part]] = {"position": Position, "rotation": Rotation}


def part(entry: Entry, embodiment: Embodiment) -> Part:
    """Return a part of a vector from its entry in the block.

    Raises:
        ConversionError: if it does not fit the robot.
    """
    ((kind, how),) = entry.items()
    if kind == "fill":
        return Fill(how)
    try:
        made: type = _MADE.get(kind) or catalogue.found("parts", kind)
        result: Part = made(how, embodiment)
    except ConversionError as error:
        raise ConversionError(f"{kind} {how['arm']}: {error}") from None
    return result
