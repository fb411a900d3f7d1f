"""Every way to read columns of joints, positions and rotations: what the block may say of them instead of what it says.

Joints are read with one change at a time, poses with every combination of words. What the block has no word for, such
as degrees of Euler angles, is read too: a finding says then that code has to do it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import rotation
from xpl.catalogue.part import arm_of
from xpl.conventions import frame as frames
from xpl.conventions import rotation as rotations
from xpl.conventions.point import POINTS, tool
from xpl.convert import ConversionError
from xpl.convert.parts import make_part

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl import Embodiment
    from xpl_cli.model_io.kinematics.samples import SampleColumns

NO_WORD = "no word of the block"
"""Mark of what only code can say."""
_INVERTED = ("quaternion_wxyz", "quaternion_xyzw", "matrix", "axis_angle")
"""Forms whose inverse is written as often; that of a 6D form is the other one, that of Euler angles no mistake seen."""


@dataclass(frozen=True)
class PoseReadings:
    """Every way to read a pose's columns: each of `words` at each of `places`; the first of both is the declared one.

    Attributes:
        words: what a way says of the numbers, by the block's keys.
        values: (W, N, 3) positions, m, or (W, N, 4) rotations: as each of them reads the rows.
        targets: arm, point and frame in which they are to be compared.
    """

    words: Sequence[Mapping[str, str]]
    values: np.ndarray
    targets: Sequence[tuple[str, str, str]]

    def words_of(self, word: int, target: int) -> dict[str, str]:
        """Return all words of one reading."""
        return {**dict(zip(("arm", "point", "frame"), self.targets[target], strict=True)), **self.words[word]}


@dataclass(frozen=True)
class JointReading:
    """One way to read an arm's joints: what it changes, "" for nothing, and the joint angles (N, dof), rad."""

    change: str
    values: np.ndarray


def joints(columns: SampleColumns, others: SampleColumns | None, embodiment: Embodiment) -> Iterator[JointReading]:
    """Yield the ways to read joints: first as declared, then with one change each.

    Args:
        columns: of one arm.
        others: those of the other arm, if there are any.
        embodiment: the robot.
    """
    entry = dict(columns.entry)
    dof = columns.rows.shape[1]
    arm = arm_of(embodiment, entry["arm"])
    names = list(entry.get("names") or arm.joint_names or ())
    sign = np.asarray(entry.get("sign", np.ones(dof)), np.float64)

    def read(change: str, rows: np.ndarray, **words: Any) -> JointReading:
        return JointReading(change, make_part({"joints": {**entry, **words}}, embodiment).write(rows))

    yield read("", columns.rows)
    unit = "rad" if entry.get("unit") == "deg" else "deg"
    yield read(f"unit: {unit}", columns.rows, unit=unit)
    if others is not None and others.rows.shape == columns.rows.shape:
        yield read(f"arm: {others.entry['arm']}", others.rows)
    yield read("sign of all joints", columns.rows, sign=(-sign).tolist())
    for index in range(dof):
        turned = sign.copy()
        turned[index] *= -1
        label = names[index] if names else f"number {index}"
        yield read(f"sign of {label}", columns.rows, sign=turned.tolist())
    if names:
        yield read("names in the reverse order", columns.rows, names=names[::-1])
        for one, two in itertools.combinations(range(dof), 2):
            order = list(names)
            order[one], order[two] = order[two], order[one]
            yield read(f"names {names[one]} and {names[two]} exchanged", columns.rows, names=order)


def positions(columns: SampleColumns, embodiment: Embodiment) -> PoseReadings:
    """Return the ways to read positions."""
    entry = {"arm": columns.entry["arm"]}
    units = _first(columns.entry.get("unit", "m"), list(frames.UNITS))
    made = [make_part({"position": {**entry, "unit": unit}}, embodiment) for unit in units]
    values = np.stack([item.write(columns.rows) for item in made])
    return PoseReadings([{"unit": unit} for unit in units], values, _targets(columns, embodiment))


def turns(columns: SampleColumns, embodiment: Embodiment) -> PoseReadings:
    """Return the ways to read rotations.

    Raises:
        ConversionError: if the rows are no rotations in the form that is declared.
    """
    words, values = zip(*_forms(columns), strict=True)
    return PoseReadings(words, np.stack(values), _targets(columns, embodiment))


def _forms(columns: SampleColumns) -> Iterator[tuple[dict[str, str], np.ndarray]]:
    """Yield each form that has as many numbers, with the rotations that it reads; the declared one first."""
    width = columns.rows.shape[1]
    declared = (columns.entry["form"], columns.entry.get("euler"))
    pairs = [
        (form, euler)
        for form in rotations.WIDTHS
        if rotations.WIDTHS[form] == width
        for euler in (rotations.ORDERS if form == "euler" else (None,))
    ]
    scales = {"": columns.rows, **({f"degrees ({NO_WORD})": np.deg2rad(columns.rows)} if width == len("xyz") else {})}
    for form, euler in [declared, *(pair for pair in pairs if pair != declared)]:
        for unit, numbers in scales.items():
            try:
                values = rotations.decode(numbers, form, euler)
            except ConversionError as error:  # these numbers are no rotation of this form
                if (form, euler) == declared:
                    raise ConversionError(f"{columns.where}: {error}") from None
                continue
            words = {"form": form, **({"euler": euler} if euler else {}), **({"unit": unit} if unit else {})}
            yield words, values
            if form in _INVERTED:
                yield {**words, "direction": f"inverse ({NO_WORD})"}, rotation.conjugate(values)


def _targets(columns: SampleColumns, embodiment: Embodiment) -> list[tuple[str, str, str]]:
    """Return arm, point and frame as declared, then the others that the standard knows of this robot."""
    entry = columns.entry
    targets = []
    for frame in _first(entry.get("frame", "world"), frames.FRAMES):
        for point in _first(entry.get("point", "flange"), POINTS):
            for arm in _first(entry["arm"], list(embodiment.data["arms"]) if frame == "world" else [entry["arm"]]):
                try:
                    offsets(embodiment, arm, point, frame)
                except ConversionError:  # the standard does not know what lies between
                    continue
                targets.append((arm, point, frame))
    return targets


@cache
def offsets(embodiment: Embodiment, arm: str, point: str, frame: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose (7,) of an arm's base in a frame, and that of a point in the flange.

    Raises:
        ConversionError: if the standard does not know them.
    """
    still = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    outer = frames.mount(embodiment, arm) if frame == "world" else still
    return outer, tool(embodiment) if point == "tcp" else still


def _first(one: str, options: Sequence[str]) -> list[str]:
    return [one, *(word for word in options if word != one)]
