"""Fields of the standard put together from parts: a position and a rotation of one arm make its pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import poses
from xpl.convert.parts import Position, Rotation

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.catalogue.part import Part, State


def assembled(parts: Sequence[Part], columns: Mapping[str, np.ndarray], state: State) -> dict[str, np.ndarray]:
    """Return the standard's fields, (H, width) by key, of absolute numbers of the model.

    Args:
        parts: of one vector.
        columns: by label of a part, (H, width) of the model's numbers.
        state: of the robot; what no part says of a pose is taken from it.
    """
    made: dict[str, np.ndarray] = {}
    for item in parts:
        if isinstance(item, (Position, Rotation)):
            if item.key not in made:
                made[item.key] = _poses([one for one in parts if one.key == item.key], columns, state[item.key])
        elif item.key:
            values = item.write(columns[item.label])
            made[item.key] = np.where(np.isnan(values), made[item.key], values) if item.key in made else values
    return made


def _poses(parts: Sequence[Part], columns: Mapping[str, np.ndarray], now: object) -> np.ndarray:
    """Return the flange's poses (H, 7) of one arm."""
    place = next((item for item in parts if isinstance(item, Position)), None)
    turn = next((item for item in parts if isinstance(item, Rotation)), None)
    pose = np.asarray(now, np.float64)
    height = len(columns[parts[0].label])
    if turn is None:
        turned = np.broadcast_to(pose[spec.POSITION_DIM :], (height, spec.POSE_DIM - spec.POSITION_DIM))
    else:
        turned = turn.frame.flange_rotation(turn.write(columns[turn.label]))
    if place is not None:
        return poses.pose(place.frame.flange_position(place.write(columns[place.label]), turned), turned)
    if turn is None:
        raise AssertionError("a pose is of a position or a rotation")
    stays = turn.frame.encode(pose)[: spec.POSITION_DIM]  # the point that is turned stays where it is
    return poses.pose(turn.frame.flange_position(np.broadcast_to(stays, (height, spec.POSITION_DIM)), turned), turned)
