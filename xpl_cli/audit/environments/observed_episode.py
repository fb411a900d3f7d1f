"""Observations and result of one episode of an environment, and the difference between two of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk

if TYPE_CHECKING:
    from xpl.contract import ObservationDict, Result


@dataclass(frozen=True)
class ObservedEpisode:
    """Observations and result of one episode.

    Attributes:
        observations: the first one, and one after every step.
        result: the environment's result of the episode.
    """

    observations: tuple[ObservationDict, ...]
    result: Result


def difference(first: ObservedEpisode, second: ObservedEpisode, tolerance: float = 0.0) -> str | None:
    """Return the first difference of two episodes, in words; None if there is none.

    Environment indices and seeds are not compared.
    """
    if len(first.observations) != len(second.observations):
        return f"one took {len(first.observations) - 1} steps, the other {len(second.observations) - 1}"
    for step, (one, other) in enumerate(zip(first.observations, second.observations, strict=True)):
        where = _difference(_without_index(one), _without_index(other), tolerance)
        if where is not None:
            return f"after step {step}: {where}"
    for key in ("success", "score", "steps", "end_reason", *(() if tolerance else ("digest",))):
        if first.result.get(key) != second.result.get(key):
            return f"the results differ in {key}: {first.result.get(key)!r} and {second.result.get(key)!r}"
    return None


def _difference(one: object, other: object, tolerance: float, where: str = "") -> str | None:
    if isinstance(one, dict) and isinstance(other, dict):
        if one.keys() != other.keys():
            return f"{where or 'the observation'} has other keys"
        differences = (
            _difference(one[key], other[key], tolerance, f"{where}.{key}" if where else str(key)) for key in one
        )
        return next((text for text in differences if text is not None), None)
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and np.array_equal(one, other):
        return None  # most are, and images are large
    if isinstance(one, (np.ndarray, float, int)) and not isinstance(one, bool):
        first, second = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
        if first.shape != second.shape:
            return f"{where} has shape {first.shape} and {second.shape}"
        gap = float(np.abs(first - second).max()) if first.size else 0.0
        return None if gap <= tolerance else f"{where} differs by {gap:.3g}"
    return None if one == other else f"{where} is {one!r} and {other!r}"


def _without_index(obs: ObservationDict) -> ObservationDict:
    return {key: value for key, value in obs.items() if key != sdk.Obs.ENV_IDX}
