"""A part of a model's vector: what it reads of the robot's state, and what it makes of the model's numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xpl.errors import ConversionError
from xpl.observation import ObservationError

if TYPE_CHECKING:
    from xpl.embodiment import Arm, Embodiment

State = Mapping[str, Any]
Numbers = np.ndarray[Any, np.dtype[Any]]


class Part(ABC):
    """One part of a vector.

    Attributes:
        kind: its word in the block.
        label: how findings call it.
        key: key of the standard's state that it is about, "" for fill.
        width: numbers that it has.
        reference: what it is counted from in an action, None if the whole vector says that.
        applied: where a change of pose is applied: fixed, body or numbers.
    """

    kind: str
    key: str = ""
    width: int
    reference: str | None = None
    applied = "fixed"

    def __init__(self, label: str) -> None:
        self.label = label

    @abstractmethod
    def read(self, state: State) -> Numbers:
        """Return the numbers (width,) float64 of a state or an absolute command of the standard."""

    @abstractmethod
    def write(self, values: Numbers) -> Numbers:
        """Return absolute numbers (..., width) as the standard's; what that is depends on the part."""

    def add(self, base: Numbers, change: Numbers) -> Numbers:
        """Return absolute numbers, (width,): a change of `base`."""
        return base + change

    def subtract(self, values: Numbers, base: Numbers) -> Numbers:
        """Return the change that leads from `base` to `values`, (width,)."""
        return values - base


def arm_of(embodiment: Embodiment, side: str) -> Arm:
    """Return an arm by its name in the spec: single, left or right.

    Raises:
        ConversionError: if the robot has no such arm.
    """
    arms = list(embodiment.data["arms"])
    if side not in arms:
        raise ConversionError(f"{embodiment.name} has no arm {side!r}; say one of {', '.join(arms)}")
    return embodiment.arms[arms.index(side)]


def of(state: State, key: str, width: int) -> Numbers:
    """Return the numbers (width,) float64 of a field of a state.

    Raises:
        ObservationError: if it is missing, or is no such numbers.
    """
    if key not in state:
        raise ObservationError(f"the state has no {key!r}, which the model_io block reads; it has {', '.join(state)}")
    try:
        given = np.asarray(state[key])
    except ValueError:  # lists of unequal lengths
        raise ObservationError(f"{key} holds lists of unequal lengths, expected {width} numbers") from None
    if given.dtype.kind not in "biuf":  # numpy would read numbers out of texts
        raise ObservationError(f"{key} holds {given.dtype}, expected numbers")
    values = given.astype(np.float64)
    if values.shape != (width,):
        raise ObservationError(f"{key} has shape {values.shape}, expected ({width},)")
    if not np.isfinite(values).all():
        raise ObservationError(f"{key} holds a value that is not finite")
    return values
