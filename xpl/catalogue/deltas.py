"""Action steps as deltas to a state, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable

import numpy as np

from xpl import _spec as spec
from xpl import rotation

if TYPE_CHECKING:
    from xpl.catalogue.mistake import ArrayMap

_POSITION, _ROTATION = slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM)

FRAMES = ("fixed", "body")
"""Frames of a pose delta: fixed axes, or the axes of the moving body."""
APPLIED = (*FRAMES, "the turn alone in body", "the move alone in body")
"""The same, and the two mixtures."""
_MOVES_IN_BODY, _TURNS_IN_BODY = {"body", APPLIED[3]}, {"body", APPLIED[2]}


def frames(action_type: str) -> tuple[str, ...]:
    """Return the frames of deltas; joint deltas have only one."""
    return FRAMES if action_type == "ee" else FRAMES[:1]


def differences(step: ArrayMap, base: ArrayMap, mode: str) -> dict[str, np.ndarray]:
    """Return the deltas from the fields of `base` to those of a step, by key, float64.

    Args:
        step: fields of one step, (width,) each; poses are (7,), position in m and unit quaternion (w, x, y, z).
        base: the fields that the deltas are relative to; it has every key of `step`.
        mode: one of `APPLIED`, the frame of pose deltas; other fields are subtracted.
    """
    return {key: _difference(key, np.asarray(value, np.float64), _of(base, key), mode) for key, value in step.items()}


def apply_differences(change: ArrayMap, base: ArrayMap, mode: str) -> dict[str, np.ndarray]:
    """Return the step that deltas to the fields of `base` lead to, float64; the inverse of `differences`.

    Args:
        change: deltas by key, (width,) each; of poses (7,), a translation in m and a unit quaternion (w, x, y, z).
        base: the fields that the deltas are relative to; it has every key of `change`.
        mode: one of `APPLIED`, the frame of pose deltas; other fields are added.
    """
    return {
        key: _apply_difference(key, np.asarray(value, np.float64), _of(base, key), mode)
        for key, value in change.items()
    }


def _of(base: ArrayMap, key: str) -> np.ndarray:
    return np.asarray(base[key], np.float64)


def select_fields(step: ArrayMap, chosen: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """Return the fields of a step that are chosen."""
    return {key: value for key, value in step.items() if chosen(key)}


def is_arm(key: str) -> bool:
    """Return whether a field belongs to an arm, not to its end effector."""
    return not key.endswith(spec.State.EE_JOINT_STATE)


def is_pose(key: str) -> bool:
    """Return whether a field is a pose."""
    return key.endswith(spec.State.EE_POSE)


def _difference(key: str, value: np.ndarray, base: np.ndarray, mode: str) -> np.ndarray:
    if not is_pose(key):
        difference: np.ndarray = value - base
        return difference
    place, back = value[_POSITION] - base[_POSITION], rotation.conjugate(base[_ROTATION])
    turn = value[_ROTATION]
    moved = rotation.rotate(back, place) if mode in _MOVES_IN_BODY else place
    turned = rotation.multiply(back, turn) if mode in _TURNS_IN_BODY else rotation.multiply(turn, back)
    return np.concatenate((moved, turned))


def _apply_difference(key: str, change: np.ndarray, base: np.ndarray, mode: str) -> np.ndarray:
    if not is_pose(key):
        total: np.ndarray = base + change
        return total
    start, place, turn = base[_ROTATION], change[_POSITION], change[_ROTATION]
    moved = rotation.rotate(start, place) if mode in _MOVES_IN_BODY else place
    turned = rotation.multiply(start, turn) if mode in _TURNS_IN_BODY else rotation.multiply(turn, start)
    return np.concatenate((base[_POSITION] + moved, turned))
