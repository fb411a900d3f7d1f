"""Point that a pose is of: flange or tcp. Source: spec/v1/model_io.schema.json#/$defs/point."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import poses, rotation
from xpl.catalogue import Case, Convention, Mistake, fields
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import alike, everywhere, parts, word
from xpl.catalogue.fields import Numbers, on
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.embodiment import Embodiment

_NAME = "point"
POINTS = ("flange", "tcp")


def tool(embodiment: Embodiment) -> np.ndarray:
    """Return the pose (7,) of the point between the fingertips in the flange.

    Raises:
        ConversionError: if the standard does not know it for this robot.
    """
    known: Mapping[str, Any] | None = embodiment.data["end_effector"].get("tcp")
    if not known:
        raise ConversionError(
            f"the standard does not know where {embodiment.name} has its fingertips; say point: flange"
        )
    return poses.pose(known["xyz"], rotation.from_rpy(known["rpy"]))


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _in_block(case: Case) -> Iterator[Mistake]:
    sites = parts(case.block, "position", "rotation") if case.block else []
    for point in reversed(POINTS):
        yield from everywhere(sites, 0, f"point: {point}", _NAME, word("point", point, POINTS[0]))
    yield from alike(case.block, ["rotation", "position"], "point", _NAME) if case.block else ()


def _around(case: Case) -> Iterator[Mistake]:
    for change in _changes(case.embodiment):
        yield from fields.mistakes(change, case)


def _changes(embodiment: Embodiment) -> Iterator[fields.Change]:
    keys = fields.poses(embodiment.prefixes)
    for hand in _tools(embodiment):
        yield from _at_tool(hand, keys)
    for rank, axis, degrees in (
        *((2, 2, degrees) for degrees in (45, -45, 90, -90, 180, 135, -135)),
        *((3, axis, degrees) for axis in (0, 1) for degrees in (90, -90, 180)),
    ):
        turn = rotation.from_axis_angle(np.deg2rad(degrees) * np.eye(3)[axis])
        there, back = (on(keys, fields.turned(partial(_by, turn=one))) for one in (turn, rotation.conjugate(turn)))
        told = f"hand: turned by {degrees:+} deg about its {'xyz'[axis]}"
        yield fields.Change(rank, told, _NAME, there, back, None)


def _tools(embodiment: Embodiment) -> Iterator[Numbers]:
    """Yield the point between the fingertips in the flange, where the standard knows it."""
    try:
        yield tool(embodiment)
    except ConversionError:
        return


def _at_tool(hand: Numbers, keys: Sequence[str]) -> Iterator[fields.Change]:
    for later, told, only in fields.PARTS:
        # A position alone moves by what the rotation says, and that stays.
        away = _unturned(hand) if told == " of the position" else poses.invert(hand)
        there, back = (on(keys, only(partial(_inside, inner=one))) for one in (hand, away))
        change = fields.Change(later, f"point{told}: tcp", _NAME, there, back, None)
        yield change
        yield change.inverse(f"point{told}: flange, not tcp")


def _inside(pose: Numbers, *, inner: Numbers) -> Numbers:
    return poses.compose(pose, inner)


def _by(quaternion: Numbers, *, turn: Numbers) -> Numbers:
    return rotation.multiply(quaternion, turn)


def _unturned(hand: Numbers) -> Numbers:
    return np.concatenate((-hand[: spec.POSITION_DIM], rotation.identity()))


CONVENTION = Convention(
    _NAME,
    in_block=_in_block,
    around=_around,
    keys={"position": ["point"], "rotation": ["point"]},
    applies=lambda block: bool({"position", "rotation"} & kinds(block)),
)
