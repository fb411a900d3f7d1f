"""Fixed rotation or translation that explains what no convention does: another frame or tool than the standard's."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from xpl import rotation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.model_io.kinematics.readings import PoseReadings

_FITS = {"mm": 5.0, "degrees": 1.0}
"""Errors up to which a fixed turn or shift explains poses."""
_COMPARED = 32
"""Rows that are compared with each other."""


def angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles, degrees, between unit quaternions (..., 4)."""
    cosine = np.minimum(np.abs((first * second).sum(-1)), 1.0)  # of half the angle; 1e-6 degrees are lost near zero
    result: np.ndarray = np.rad2deg(2 * np.arccos(cosine))
    return result


def of_positions(positions: np.ndarray, expected: np.ndarray) -> str:
    """Return what is left over between positions (N, 3), m, and the poses (N, 7) that were expected."""
    about = expected[:, :3].mean(0), positions.mean(0)
    turn = _kabsch(expected[:, :3] - about[0], positions - about[1])
    shift = about[1] - rotation.rotate(turn, about[0])
    outside = _rms(positions - rotation.rotate(turn, expected[:, :3]) - shift)
    tool = rotation.rotate(rotation.conjugate(expected[:, 3:]), positions - expected[:, :3])
    inside = _rms(tool - tool.mean(0))
    if min(inside, outside) > _FITS["mm"]:
        return "no fixed frame and no fixed tool explains them either"
    if inside <= outside:
        return f"with the point shifted by {_metres(tool.mean(0))} m in the tool they agree to {inside:.1f} mm"
    return f"in a frame turned by {_turn(turn)} and shifted by {_metres(shift)} m they agree to {outside:.1f} mm"


def of_rotations(readings: PoseReadings, expected: Sequence[np.ndarray]) -> str:
    """Return what is left over between rotations, as each form reads them, and those that were expected.

    How far rotations are apart among themselves depends on no frame and no tool, so that the form is told even so.

    Args:
        readings: of the rows.
        expected: poses (N, 7) at each of their places.
    """
    by_form: dict[str, np.ndarray] = {}
    for words, values in zip(readings.words, readings.values, strict=True):
        name = [f"{key}: {words[key]}" for key in ("form", "euler", "unit", "direction") if key in words]
        by_form.setdefault(", ".join(name), values)
    one, two = np.triu_indices(min(len(expected[0]), _COMPARED), 1)
    expected_angles = angles(expected[0][one, 3:], expected[0][two, 3:])
    errors = {
        form: _rms((angles(values[one], values[two]) - expected_angles)[:, None], 1.0)
        for form, values in by_form.items()
    }
    forms = [form for form, error in errors.items() if error <= _FITS["degrees"]]
    if not forms:
        return "no form explains how far they are apart among themselves, in no frame and with no tool"
    fits: list[tuple[float, str]] = []
    for form, (location, poses) in itertools.product(forms, zip(readings.targets, expected, strict=True)):
        _, point, frame = location
        outer = rotation.multiply(by_form[form], rotation.conjugate(poses[:, 3:]))
        inner = rotation.multiply(rotation.conjugate(poses[:, 3:]), by_form[form])
        for turns, description in ((outer, f"the {frame} frame"), (inner, f"the {point}")):
            mean = _mean(turns)
            error = float(np.sqrt((angles(turns, mean) ** 2).mean()))
            fits.append(
                (error, f"with {form} and {description} turned by {_turn(mean)} they agree to {error:.1f} degrees")
            )
    error, description = min(fits, key=lambda fit: round(fit[0], 3))  # of those alike the first, which is as declared
    if error > _FITS["degrees"]:
        return f"{' or '.join(forms)} fits, in another frame and with another tool than the standard's"
    return description


def _mean(turns: np.ndarray) -> np.ndarray:
    """Return the mean of rotations (N, 4) that are nearly one: the main direction, whatever their signs."""
    _, vectors = np.linalg.eigh(turns.T @ turns)
    return rotation.normalise(vectors[:, -1])


def _kabsch(there: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return the rotation (4,) that takes points (N, 3) nearest to others. Kabsch 1976."""
    left, _, right = np.linalg.svd(there.T @ here)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return rotation.from_matrix((left @ flip @ right).T)


def _rms(values: np.ndarray, scale: float = 1000.0) -> float:
    return scale * float(np.sqrt((values * values).sum(-1).mean()))


def _metres(values: np.ndarray) -> str:
    return f"[{', '.join(f'{value + 0.0:.3f}' for value in values.round(3))}]"


def _turn(quaternion: np.ndarray) -> str:
    vector = np.rad2deg(rotation.to_axis_angle(quaternion))
    angle = float(np.linalg.norm(vector))
    if angle < 0.05:  # what would be printed as zero
        return "0 degrees"
    axis = vector / angle
    return f"{angle:.1f} degrees about [{', '.join(f'{value + 0.0:.2f}' for value in axis.round(2))}]"
