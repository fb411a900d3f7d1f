"""Commands that are a straight line of what they should be: a scale or an offset that no list of changes has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as spec
from xpl_cli.native.difference import Answers, Thread, columns
from xpl_cli.native.explain import Tried

if TYPE_CHECKING:
    from xpl_cli.native.difference import Differences

_FALLS = 20.0
"""By how much the difference of each number has to fall."""
_LEAST = 12
"""Numbers that a line is drawn through at least."""


def fitted(
    threads: Sequence[Thread], before: Differences, spread: Mapping[str, float], tolerance: float
) -> Tried | None:
    """Return the change by which each number that differs is a straight line of the native one, or None.

    Args:
        threads: all episodes.
        before: how far the answers are, by number.
        spread: of `difference.spreads`.
        tolerance: largest share that is no difference.
    """
    native = [chunk for thread in threads for chunk in thread.native]
    given = [chunk for thread in threads for chunk in thread.given]
    if any(len(one) != len(other) for one, other in zip(native, given, strict=True)):
        return None
    wanted, found = columns(native), columns(given)
    starts = _starts(given, [thread.observations[place]["state"] for thread in threads for place in thread.asked])
    remaining, told, slopes = dict(before), [], []
    for part in (part for part, value in before.items() if value > tolerance):
        key, index = part.rstrip("]").split("[")
        if key not in found or (key.endswith(spec.State.EE_POSE) and int(index) >= spec.POSITION_DIM):
            return None
        line = _line(
            wanted[key][:, int(index)], found[key][:, int(index)], starts[key][:, int(index)], key, spread[part]
        )
        if line is None:
            return None
        rest, slope, words = line
        if rest > tolerance or rest * _FALLS > before[part]:
            return None
        remaining[part] = rest
        told.append(f"{part}: {words}")
        slopes.append((key, slope))
    if not told:
        return None
    return Tried(_summary(told), _convention(slopes), remaining)


def _starts(given: Answers, states: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    rows: dict[str, list[np.ndarray]] = {}
    for steps, state in zip(given, states, strict=True):
        for step in steps:
            for key in step:
                rows.setdefault(key, []).append(np.asarray(state[key], np.float64))
    return {key: np.stack(values) for key, values in rows.items()}


def _line(
    wanted: np.ndarray, found: np.ndarray, start: np.ndarray, key: str, spread: float
) -> tuple[float, float, str] | None:
    """Return what remains, the slope and the words of wanted = slope * found + constant, of values or of changes."""
    inside = np.ones(len(found), bool)
    if key.endswith(spec.State.EE_JOINT_STATE):  # what is quite closed or open may have been clipped
        inside = (found > spec.GRIPPER_CLOSED) & (found < spec.GRIPPER_OPEN)
        inside &= (wanted > spec.GRIPPER_CLOSED) & (wanted < spec.GRIPPER_OPEN)
    if inside.sum() < max(_LEAST, len(found) // 4):
        return None
    best: tuple[float, float, str] | None = None
    for words, base in (("answer", np.zeros_like(start)), ("change of the state", start)):
        x, y = (found - base)[inside], (wanted - base)[inside]
        if np.ptp(x) <= 1e-9:
            continue
        slope, constant = np.polyfit(x, y, 1)
        rest = float(np.abs(slope * x + constant - y).max()) / spread
        line = f"native = {slope:.4g} * {words}" + (f" {constant:+.3g}" if abs(constant) > 1e-6 else "")
        if best is None or rest < best[0]:
            best = rest, float(slope), line
    return best


def _summary(told: Sequence[str]) -> str:
    more = f" (and {len(told) - 1} more numbers)" if len(told) > 1 else ""
    return told[0] + more


def _convention(slopes: Sequence[tuple[str, float]]) -> str:
    """Return what a scale is about: grippers have their own; a factor of 57.3 is degrees; others normalise."""
    if all(key.endswith(spec.State.EE_JOINT_STATE) for key, _ in slopes):
        return "gripper"
    factors = (np.rad2deg(1.0), np.deg2rad(1.0))
    if all(min(abs(abs(slope) / factor - 1.0) for factor in factors) < 1e-3 for _, slope in slopes):
        return "angle_unit"
    if all(abs(abs(slope) - 1.0) < 1e-3 for _, slope in slopes):
        return "joint_order"
    return "normalization"
