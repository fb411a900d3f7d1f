"""Action steps as differences to a state, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable

import numpy as np

from xpl import _spec as spec
from xpl import rotation

if TYPE_CHECKING:
    from xpl.catalogue.mistake import Given

_PLACE, _TURN = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)

MODES = ("fixed", "body")
"""Where a change of pose is applied: in the frame of the pose, or in the moving one."""
APPLIED = (*MODES, "the turn alone in body", "the move alone in body")
"""The same, and the two ways to mix them."""
_MOVES_IN_BODY, _TURNS_IN_BODY = {"body", APPLIED[3]}, {"body", APPLIED[2]}


def modes(action_type: str) -> tuple[str, ...]:
    """Return where changes may be applied: joints have one frame only."""
    return MODES if action_type == "ee" else MODES[:1]


def apart(step: Given, base: Given, mode: str) -> dict[str, np.ndarray]:
    """Return by key what leads from the fields of `base` to those of a step."""
    return {key: _apart(key, np.asarray(value, np.float64), _of(base, key), mode) for key, value in step.items()}


def together(change: Given, base: Given, mode: str) -> dict[str, np.ndarray]:
    """Return the step that a change of the fields of `base` leads to."""
    return {key: _together(key, np.asarray(value, np.float64), _of(base, key), mode) for key, value in change.items()}


def _of(base: Given, key: str) -> np.ndarray:
    return np.asarray(base[key], np.float64)


def kept(step: Given, chosen: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """Return the fields of a step that are chosen."""
    return {key: value for key, value in step.items() if chosen(key)}


def is_arm(key: str) -> bool:
    """Tell whether a field is of an arm, not of what it holds things with."""
    return not key.endswith(spec.State.EE_JOINT_STATE)


def is_pose(key: str) -> bool:
    """Tell whether a field is a pose."""
    return key.endswith(spec.State.EE_POSE)


def _apart(key: str, value: np.ndarray, base: np.ndarray, mode: str) -> np.ndarray:
    if not is_pose(key):
        difference: np.ndarray = value - base
        return difference
    place, back = value[_PLACE] - base[_PLACE], rotation.conjugate(base[_TURN])
    turn = value[_TURN]
    moved = rotation.rotate(back, place) if mode in _MOVES_IN_BODY else place
    turned = rotation.multiply(back, turn) if mode in _TURNS_IN_BODY else rotation.multiply(turn, back)
    return np.concatenate((moved, turned))


def _together(key: str, change: np.ndarray, base: np.ndarray, mode: str) -> np.ndarray:
    if not is_pose(key):
        total: np.ndarray = base + change
        return total
    start, place, turn = base[_TURN], change[_PLACE], change[_TURN]
    moved = rotation.rotate(start, place) if mode in _MOVES_IN_BODY else place
    turned = rotation.multiply(start, turn) if mode in _TURNS_IN_BODY else rotation.multiply(turn, start)
    return np.concatenate((base[_PLACE] + moved, turned))
