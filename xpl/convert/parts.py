"""Parts of a model's vectors: position, rotation and fill values in the model's units, and back.

Source: spec/v1/model_io.schema.json#/$defs/part. A part converts a state to the model's values, and a
command to the fields of an arm; position and rotation of one arm together make its pose.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation
from xpl.catalogue import convention as catalogue
from xpl.catalogue.part import Numbers, Part, State, arm_of, state_field
from xpl.conventions import rotation as forms
from xpl.conventions.frame import UNITS
from xpl.convert.frames import PoseFrame
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from xpl.contract import Entry
    from xpl.embodiment import Embodiment

_POSITION = slice(0, spec.POSITION_DIM)
_ROTATION = slice(spec.POSITION_DIM, spec.POSE_DIM)


class PosePart(Part):
    """A part of the pose of an arm's point."""

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(f"{self.kind} {entry['arm']}")
        arm = arm_of(embodiment, entry["arm"])
        self.key = arm.prefix + spec.State.EE_POSE
        self.frame = PoseFrame(embodiment, entry["arm"], entry.get("point", "flange"), entry.get("frame", "world"))
        self.reference = entry.get("reference")
        self.applied = entry.get("applied", "fixed")


class PositionPart(PosePart):
    """Position of a point of an arm."""

    kind = "position"
    width = spec.POSITION_DIM

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(entry, embodiment)
        self.unit = UNITS[entry.get("unit", "m")]

    def read(self, state: State) -> Numbers:
        """Return the model values (width,) of a state."""
        return self.frame.encode(state_field(state, self.key, spec.POSE_DIM))[_POSITION] * self.unit

    def write(self, values: Numbers) -> Numbers:
        """Return absolute model values (..., width) in the standard's units."""
        return values / self.unit

    def to_fixed_frame(self, change: Numbers, quaternion: Numbers) -> Numbers:
        """Return a delta (..., 3) of the moving frame in the fixed frame."""
        return rotation.rotate(quaternion, change)


class RotationPart(PosePart):
    """Rotation of a point of an arm."""

    kind = "rotation"

    def __init__(self, entry: Entry, embodiment: Embodiment) -> None:
        super().__init__(entry, embodiment)
        self.form: str = entry["form"]
        self._euler = entry.get("euler")
        self.width = forms.WIDTHS[self.form]
        self._sign = entry.get("sign", "any")
        if self._sign != "any" and not self.form.startswith("quaternion"):
            raise ConversionError(f"sign is for quaternions, the form is {self.form}; remove it")
        axes = str(self._euler or "").lower()
        if any(one == two for one, two in zip(axes, axes[1:])):
            raise ConversionError(
                f"euler {self._euler} has the same axis twice in a row; use another order, such as xyz"
            )

    def read(self, state: State) -> Numbers:
        """Return the model values (width,) of a state."""
        quaternion = self.frame.encode(state_field(state, self.key, spec.POSE_DIM))[_ROTATION]
        if self._sign == "positive_w" and quaternion[0] < 0:
            quaternion = -quaternion
        return forms.encode(quaternion, self.form, self._euler)

    @property
    def is_continuous(self) -> bool:
        """Whether the sign of its quaternion follows the previous step."""
        return bool(self._sign == "continuous")

    def scalar(self, values: Numbers) -> float:
        """Return w of a quaternion (4,) of its form."""
        return float(values[0 if self.form == "quaternion_wxyz" else -1])

    def write(self, values: Numbers) -> Numbers:
        """Return unit quaternions (..., 4)."""
        try:
            return forms.decode(values, self.form, self._euler)
        except ConversionError as error:
            raise ConversionError(f"model_io.action, {self.label}: {error}") from None

    def add(self, base: Numbers, change: Numbers) -> Numbers:
        """Return the rotation (width,) of a delta to `base`."""
        if self.applied == "numbers":
            return base + change
        one, by = self.write(base), self.write(change)
        turned = rotation.multiply(one, by) if self.applied == "body" else rotation.multiply(by, one)
        return forms.encode(turned, self.form, self._euler)

    def subtract(self, values: Numbers, base: Numbers) -> Numbers:
        """Return the delta (width,) from `base` to `values`."""
        if self.applied == "numbers":
            return values - base
        to, back = self.write(values), rotation.conjugate(self.write(base))
        change = rotation.multiply(back, to) if self.applied == "body" else rotation.multiply(to, back)
        return forms.encode(change, self.form, self._euler)


class FillPart(Part):
    """Constant values without meaning."""

    kind = "fill"

    def __init__(self, entry: Entry) -> None:
        super().__init__("fill")
        self.width = entry["width"]
        self.reference = "absolute"
        self._value = entry.get("value", 0.0)

    def read(self, state: State) -> Numbers:
        """Return the constant values (width,)."""
        del state
        return np.full(self.width, float(self._value))

    def write(self, values: Numbers) -> Numbers:
        """Return absolute model values (..., width) in the standard's units."""
        return values


_POSE_PARTS: dict[str, type[Part]] = {"position": PositionPart, "rotation": RotationPart}


def make_part(entry: Entry, embodiment: Embodiment) -> Part:
    """Return a part of a vector from its entry in the block.

    Raises:
        ConversionError: it does not fit the robot.
    """
    ((kind, how),) = entry.items()
    if kind == "fill":
        return FillPart(how)
    try:
        part_class: type = _POSE_PARTS.get(kind) or catalogue.lookup("parts", kind)
        result: Part = part_class(how, embodiment)
    except ConversionError as error:
        raise ConversionError(f"{kind} {how['arm']}: {error}") from None
    return result
