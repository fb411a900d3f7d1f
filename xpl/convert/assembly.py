"""Assembly of the standard's fields from parts: position and rotation of one arm make its pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import poses
from xpl.convert.parts import PositionPart, RotationPart

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.catalogue.part import Part, State


def assemble(parts: Sequence[Part], columns: Mapping[str, np.ndarray], state: State) -> dict[str, np.ndarray]:
    """Return the standard's fields of absolute model values.

    Args:
        parts: parts of one vector.
        columns: (H, width) model values by label of the part.
        state: of the robot; supplies the components of a pose that no part has.

    Returns:
        (H, width) by key of the standard.
    """
    made: dict[str, np.ndarray] = {}
    for item in parts:
        if isinstance(item, (PositionPart, RotationPart)):
            if item.key not in made:
                made[item.key] = _poses([one for one in parts if one.key == item.key], columns, state[item.key])
        elif item.key:
            values = item.write(columns[item.label])
            made[item.key] = np.where(np.isnan(values), made[item.key], values) if item.key in made else values
    return made


def _poses(parts: Sequence[Part], columns: Mapping[str, np.ndarray], now: object) -> np.ndarray:
    """Return the flange poses (H, 7) of one arm."""
    position = next((item for item in parts if isinstance(item, PositionPart)), None)
    turn = next((item for item in parts if isinstance(item, RotationPart)), None)
    pose = np.asarray(now, np.float64)
    height = len(columns[parts[0].label])
    if turn is None:
        turned = np.broadcast_to(pose[spec.POSITION_DIM :], (height, spec.POSE_DIM - spec.POSITION_DIM))
    else:
        turned = turn.frame.flange_rotation(turn.write(columns[turn.label]))
    if position is not None:
        return poses.pose(position.frame.flange_position(position.write(columns[position.label]), turned), turned)
    if turn is None:
        raise AssertionError("a pose has a position or a rotation")
    stays = turn.frame.encode(pose)[: spec.POSITION_DIM]  # the point stays where it is, only its rotation changes
    return poses.pose(turn.frame.flange_position(np.broadcast_to(stays, (height, spec.POSITION_DIM)), turned), turned)
