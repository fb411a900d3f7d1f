"""Point that a pose is of: flange or tcp. Source: spec/v1/model_io.schema.json#/$defs/point."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl import poses, rotation
from xpl.catalogue import AdapterCase, Convention, Mistake, fields
from xpl.catalogue.convention import kinds
from xpl.catalogue.edits import copy_between_state_and_action, mistakes_at_sites, parts, set_key
from xpl.catalogue.fields import Numbers, map_fields
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
    tcp: Mapping[str, Any] | None = embodiment.data["end_effector"].get("tcp")
    if not tcp:
        raise ConversionError(
            f"the standard does not know where {embodiment.name} has its fingertips; say point: flange"
        )
    return poses.pose(tcp["xyz"], rotation.from_rpy(tcp["rpy"]))


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _config_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    sites = parts(case.block, "position", "rotation") if case.block else []
    for point in reversed(POINTS):
        yield from mistakes_at_sites(sites, 0, f"point: {point}", _NAME, set_key("point", point, POINTS[0]))
    yield from copy_between_state_and_action(case.block, ["rotation", "position"], "point", _NAME) if case.block else ()


def _io_mistakes(case: AdapterCase) -> Iterator[Mistake]:
    for change in _changes(case.embodiment):
        yield from fields.field_mistakes(change, case)


def _changes(embodiment: Embodiment) -> Iterator[fields.FieldChange]:
    keys = fields.pose_fields(embodiment.prefixes)
    for hand in _tools(embodiment):
        yield from _tcp_changes(hand, keys)
    for rank, axis, degrees in (
        *((2, 2, degrees) for degrees in (45, -45, 90, -90, 180, 135, -135)),
        *((3, axis, degrees) for axis in (0, 1) for degrees in (90, -90, 180)),
    ):
        turn = rotation.from_axis_angle(np.deg2rad(degrees) * np.eye(3)[axis])
        there, back = (
            map_fields(keys, fields.map_rotations(partial(_append_rotation, turn=one)))
            for one in (turn, rotation.conjugate(turn))
        )
        label = f"hand: turned by {degrees:+} deg about its {'xyz'[axis]}"
        yield fields.FieldChange(rank, label, _NAME, there, back, None)


def _tools(embodiment: Embodiment) -> Iterator[Numbers]:
    """Yield the point between the fingertips in the flange, where the standard knows it."""
    try:
        yield tool(embodiment)
    except ConversionError:
        return


def _tcp_changes(hand: Numbers, keys: Sequence[str]) -> Iterator[fields.FieldChange]:
    for extra_rank, label, only in fields.PARTS:
        # A position alone moves by what the rotation says, and that stays.
        away = _inverse_translation(hand) if label == " of the position" else poses.invert(hand)
        there, back = (map_fields(keys, only(partial(_append_transform, inner=one))) for one in (hand, away))
        change = fields.FieldChange(extra_rank, f"point{label}: tcp", _NAME, there, back, None)
        yield change
        yield change.inverse(f"point{label}: flange, not tcp")


def _append_transform(pose: Numbers, *, inner: Numbers) -> Numbers:
    return poses.compose(pose, inner)


def _append_rotation(quaternion: Numbers, *, turn: Numbers) -> Numbers:
    return rotation.multiply(quaternion, turn)


def _inverse_translation(hand: Numbers) -> Numbers:
    return np.concatenate((-hand[: spec.POSITION_DIM], rotation.identity()))


CONVENTION = Convention(
    _NAME,
    config_mistakes=_config_mistakes,
    io_mistakes=_io_mistakes,
    keys={"position": ["point"], "rotation": ["point"]},
    applies=lambda block: bool({"position", "rotation"} & kinds(block)),
)
