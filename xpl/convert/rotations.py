"""Rotations in the forms that models write them, and the standard's unit quaternions ``[w, x, y, z]``.

Source: spec/v1/model_io.schema.json#/$defs/rotation; the tests hold every form against scipy's Rotation.
"""

from __future__ import annotations

import numpy as np

from xpl import rotation
from xpl.convert.errors import ConversionError

WIDTHS = {
    "quaternion_wxyz": 4,
    "quaternion_xyzw": 4,
    "matrix": 9,
    "rot6d_columns": 6,
    "rot6d_rows": 6,
    "axis_angle": 3,
    "euler": 3,
}
"""How many numbers each form has."""

_AXES = {"x": 0, "y": 1, "z": 2}


def encode(quaternion: np.ndarray, form: str, euler: str | None = None) -> np.ndarray:
    """Return unit quaternions (..., 4) in a form, (..., width)."""
    if form.startswith("quaternion"):
        return np.roll(np.asarray(quaternion, np.float64), 0 if form == "quaternion_wxyz" else -1, axis=-1)
    if form == "axis_angle":
        return rotation.to_axis_angle(quaternion)
    matrix = rotation.to_matrix(quaternion)
    leading = matrix.shape[:-2]
    if form == "euler":
        return _to_euler(matrix, str(euler))
    vectors = np.swapaxes(matrix, -1, -2) if form == "rot6d_columns" else matrix
    return vectors[..., : WIDTHS[form] // 3, :].reshape(*leading, WIDTHS[form])


def decode(values: np.ndarray, form: str, euler: str | None = None) -> np.ndarray:
    """Return the unit quaternions (..., 4) of rotations in a form, (..., width).

    Regressed numbers are never exact: quaternions are scaled to length one, matrices and 6D forms made orthogonal
    (Gram-Schmidt, the first vector keeps its direction).

    Raises:
        ConversionError: if the numbers are no rotation, such as a quaternion of length zero.
    """
    array = np.asarray(values, np.float64)
    if form in ("quaternion_wxyz", "quaternion_xyzw"):
        found = array if form == "quaternion_wxyz" else np.roll(array, 1, axis=-1)
        if not (np.linalg.norm(found, axis=-1) > 1e-6).all():
            raise ConversionError("a quaternion of the model has length zero, which is no rotation")
        return rotation.normalise(found)
    if form == "axis_angle":
        return rotation.from_axis_angle(array)
    if form == "euler":
        return _from_euler(array, str(euler))
    leading = array.shape[:-1]
    if form == "rot6d_columns":
        first, second = array[..., :3], array[..., 3:]
        return rotation.from_matrix(np.swapaxes(_orthogonal(first, second), -1, -2))
    rows = array.reshape(*leading, -1, 3)
    return rotation.from_matrix(_orthogonal(rows[..., 0, :], rows[..., 1, :]))


def _orthogonal(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) whose rows are the two vectors made orthonormal, and their cross product."""
    lengths = np.linalg.norm(first, axis=-1, keepdims=True)
    one = first / np.where(lengths > 0, lengths, 1.0)
    rest = second - (one * second).sum(-1, keepdims=True) * one
    height = np.linalg.norm(rest, axis=-1, keepdims=True)
    if not ((lengths > 1e-6).all() and (height > 1e-6).all()):
        raise ConversionError("two vectors of the model's rotation are zero or parallel, which is no rotation")
    two = rest / height
    return np.stack((one, two, np.cross(one, two)), axis=-2)


def _from_euler(angles: np.ndarray, order: str) -> np.ndarray:
    result = rotation.identity()
    for letter, angle in zip(order, np.moveaxis(angles, -1, 0)):
        axis = np.eye(3)[_AXES[letter.lower()]]
        turn = rotation.from_axis_angle(angle[..., None] * axis)
        result = rotation.multiply(result, turn) if order.isupper() else rotation.multiply(turn, result)
    return result


def _to_euler(matrix: np.ndarray, order: str) -> np.ndarray:
    """Return three angles (..., 3), rad: the middle one in -pi/2..pi/2, or in 0..pi where two axes are the same.

    Where the middle turn makes the other two one, the third angle is zero (as scipy has it).
    """
    letters = order.lower() if order.isupper() else order.lower()[::-1]
    i, j, k = (_AXES[letter] for letter in letters)
    proper = i == k
    if proper:
        k = 3 - i - j
    even = (j - i) % 3 == 1
    sign = 1.0 if even else -1.0
    m = matrix
    locked = np.arctan2(sign * m[..., k, j], m[..., j, j])
    if proper:
        middle = np.arctan2(np.hypot(m[..., i, j], m[..., i, k]), m[..., i, i])
        free = np.sin(middle) > 1e-7
        first = np.where(free, np.arctan2(m[..., j, i], -sign * m[..., k, i]), locked)
        last = np.where(free, np.arctan2(m[..., i, j], sign * m[..., i, k]), 0.0)
    else:
        middle = np.arctan2(sign * m[..., i, k], np.hypot(m[..., i, i], m[..., i, j]))
        free = np.cos(middle) > 1e-7
        first = np.where(free, np.arctan2(-sign * m[..., j, k], m[..., k, k]), locked)
        last = np.where(free, np.arctan2(-sign * m[..., i, j], m[..., i, i]), 0.0)
    angles = np.stack((first, middle, last), axis=-1)
    return angles if order.isupper() else angles[..., ::-1]
