"""Commanded poses for simulators that are told changes: how far to move and to turn in one control step.

The standard commands poses. Many benchmarks take a change, and their policies were trained to say one. Which pose a
change counts from decides what a simulator is told:

- ``measured``: the pose of the arm now. The arm goes to the commanded pose, however it was disturbed.
- ``commanded``: the command before, at first the observed pose. A policy whose own changes were added up to poses
  (`delta_command` of the model_io block) has each of them executed as the model said it, in chunks of any length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as spec
from xpl import rotation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["COMMANDED", "MEASURED", "Changes", "bounded"]

MEASURED, COMMANDED = "measured", "commanded"


class Changes:
    """Turns the commanded poses of one arm into changes.

    Args:
        counted_from: "measured" or "commanded", see above.

    Raises:
        ValueError: it is neither.
    """

    def __init__(self, counted_from: str) -> None:
        if counted_from not in (MEASURED, COMMANDED):
            raise ValueError(f"changes count from {MEASURED} or {COMMANDED} poses, got {counted_from!r}")
        self.counted_from = counted_from
        self._before: list[float] | None = None

    def begin(self, observed: ArrayLike) -> None:
        """Begin an episode at the pose (7,) that a policy observes first."""
        # Observations are float32, and what a policy adds to them has to come out again.
        self._before = np.asarray(observed, dtype=np.float32).tolist()

    def base(self, present: list[float]) -> list[float]:
        """Return the pose (7,) that the next change counts from; `present` (7,) is where the arm is.

        Raises:
            RuntimeError: no episode has begun.
        """
        if self._before is None:
            raise RuntimeError("no episode has begun: call begin with its first pose")
        return present if self.counted_from == MEASURED else self._before

    def change(self, commanded: ArrayLike, present: ArrayLike) -> NDArray[np.float64]:
        """Return how far a command (7,) moves and turns the arm.

        Args:
            commanded: pose of the action.
            present: pose of the arm now.

        Returns:
            (6,) float64: m along the axes of the world, then the rotation vector in the world, rad.
        """
        now, wanted = (np.asarray(pose, dtype=np.float64).tolist() for pose in (present, commanded))
        base = self.base(now)
        moved = self.move(wanted, now)
        back = rotation.conjugate(rotation.normalise(base[spec.POSITION_DIM :]))
        turn = rotation.multiply(rotation.normalise(wanted[spec.POSITION_DIM :]), back)
        return np.concatenate([moved, rotation.to_axis_angle(turn)])

    def move(self, commanded: list[float], present: list[float]) -> list[float]:
        """Return how far a command moves the arm, m along the three axes, where a simulator does not turn it.

        Takes and returns plain numbers: so few cost a fraction of what numpy takes for them.
        """
        base, self._before = self.base(present), commanded
        return [to - at for to, at in zip(commanded[: spec.POSITION_DIM], base)]


def bounded(values: list[float], *, together: bool) -> tuple[list[float], float]:
    """Return a command within -1 and 1, and how far its largest number lay outside.

    Args:
        values: plain numbers.
        together: whether all are made smaller alike, so that a long way keeps its direction, or each is cut off by
            itself, as benchmarks do.
    """
    largest = max(map(abs, values))
    if largest <= 1.0:
        return values, 0.0
    if together:
        return [value / largest for value in values], largest - 1.0
    return [min(max(value, -1.0), 1.0) for value in values], largest - 1.0
