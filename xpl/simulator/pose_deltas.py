"""Commanded poses as delta actions, translation and rotation of one step, for simulators that take those.

The standard commands poses. Many benchmarks take delta actions, and their policies were trained on them. The base pose
of a delta is one of two:

- ``measured``: the pose of the arm now. The arm goes to the commanded pose, however it was disturbed.
- ``commanded``: the previous command, at first the observed pose. If a policy's deltas were accumulated to poses
  (`delta_command` of the model_io block), each is executed as the model predicted it, in chunks of any length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["COMMANDED", "MEASURED", "PoseDeltas", "clip"]

MEASURED, COMMANDED = "measured", "commanded"


class PoseDeltas:
    """Converts the commanded poses of one arm into deltas.

    Args:
        counted_from: base pose of a delta, "measured" or "commanded".

    Raises:
        ValueError: it is neither.
    """

    def __init__(self, counted_from: str) -> None:
        if counted_from not in (MEASURED, COMMANDED):
            raise ValueError(f"deltas count from {MEASURED} or {COMMANDED} poses, got {counted_from!r}")
        self.counted_from = counted_from
        self._before: list[float] | None = None

    def begin(self, observed: ArrayLike) -> None:
        """Begin an episode at the first observed pose, (7,)."""
        # Observations are float32: a delta that a policy added to them must be recovered exactly.
        self._before = np.asarray(observed, dtype=np.float32).tolist()

    def base(self, present: list[float]) -> list[float]:
        """Return the base pose (7,) of the next delta; `present` (7,) is the measured pose.

        Raises:
            RuntimeError: no episode has begun.
        """
        if self._before is None:
            raise RuntimeError("no episode has begun: call begin with its first pose")
        return present if self.counted_from == MEASURED else self._before

    def delta(self, commanded: ArrayLike, present: ArrayLike) -> NDArray[np.float64]:
        """Return the delta of a command.

        Args:
            commanded: (7,) pose of the action: m, unit quaternion (w first).
            present: (7,) measured pose.

        Returns:
            (6,) float64: translation in the world frame, m, then rotation vector in the world frame, rad.
        """
        now, target = (np.asarray(pose, dtype=np.float64).tolist() for pose in (present, commanded))
        base = self.base(now)
        moved = self.translation(target, now)
        back = rotation.conjugate(rotation.normalise(base[spec.POSITION_DIM :]))
        turn = rotation.multiply(rotation.normalise(target[spec.POSITION_DIM :]), back)
        return np.concatenate([moved, rotation.to_axis_angle(turn)])

    def translation(self, commanded: list[float], present: list[float]) -> list[float]:
        """Return the translation of a command, [x, y, z] in m, for simulators without rotation.

        Takes and returns lists of float, which are faster than numpy for so few numbers.
        """
        base, self._before = self.base(present), commanded
        return [to - at for to, at in zip(commanded[: spec.POSITION_DIM], base)]


def clip(values: list[float], *, together: bool) -> tuple[list[float], float]:
    """Return a command within [-1, 1], and by how much its largest component exceeded it.

    Args:
        values: components of the command, floats.
        together: scale all components by one factor, which keeps the direction, instead of clipping each, as
            benchmarks do.

    Returns:
        The components within [-1, 1], and max(0, largest absolute component - 1).
    """
    largest = max(map(abs, values))
    if largest <= 1.0:
        return values, 0.0
    if together:
        return [value / largest for value in values], largest - 1.0
    return [min(max(value, -1.0), 1.0) for value in values], largest - 1.0
