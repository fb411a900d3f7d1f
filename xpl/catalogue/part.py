"""A part of a model's vector: conversion from the robot's state to the model's numbers, and back."""

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
        kind: its key in the block.
        label: its name in findings.
        key: key of the standard's state, "" for fill.
        width: number of values.
        reference: base of its values in an action, None for that of the whole vector.
        applied: frame of a pose delta: fixed, body or numbers.
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
        """Return absolute values (..., width) of the model as the standard's; their form depends on the part."""

    def add(self, base: Numbers, change: Numbers) -> Numbers:
        """Return the absolute values (width,) of a delta to `base`."""
        return base + change

    def subtract(self, values: Numbers, base: Numbers) -> Numbers:
        """Return the delta (width,) from `base` to `values`."""
        return values - base


def arm_of(embodiment: Embodiment, side: str) -> Arm:
    """Return an arm by its name in the spec: single, left or right.

    Raises:
        ConversionError: the robot has no such arm.
    """
    arms = list(embodiment.data["arms"])
    if side not in arms:
        raise ConversionError(f"{embodiment.name} has no arm {side!r}; expected one of {', '.join(arms)}")
    return embodiment.arms[arms.index(side)]


def state_field(state: State, key: str, width: int) -> Numbers:
    """Return a field of a state, (width,) float64.

    Args:
        state: the map `state` of an observation.
        key: key of the field, with the arm's prefix.
        width: number of its values.

    Raises:
        ObservationError: the field is missing, or is no array (width,) of finite numbers.
    """
    if key not in state:
        raise ObservationError(f"the state has no {key!r}, which the model_io block reads; it has {', '.join(state)}")
    try:
        array = np.asarray(state[key])
    except ValueError:  # lists of unequal lengths
        raise ObservationError(f"{key} holds lists of unequal lengths, expected {width} numbers") from None
    if array.dtype.kind not in "biuf":  # numpy would parse numbers in strings
        raise ObservationError(f"{key} holds {array.dtype}, expected numbers")
    values = array.astype(np.float64)
    if values.shape != (width,):
        raise ObservationError(f"{key} has shape {values.shape}, expected ({width},)")
    if not np.isfinite(values).all():
        raise ObservationError(f"{key} holds a value that is not finite")
    return values
