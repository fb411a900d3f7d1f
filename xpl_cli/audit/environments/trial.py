"""What was seen of an environment in one episode, and where two of them differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk

if TYPE_CHECKING:
    from xpl.contract import ObservationDict, Result


@dataclass(frozen=True)
class Trial:
    """What was seen of one environment in one episode.

    Attributes:
        seen: observations, the first and one after every step.
        result: what the environment says of the episode.
    """

    seen: tuple[ObservationDict, ...]
    result: Result


def difference(first: Trial, second: Trial, tolerance: float = 0.0) -> str | None:
    """Return where two trials differ first, in words; None if they do not.

    Indices of environments do not count, nor do seeds.
    """
    if len(first.seen) != len(second.seen):
        return f"one took {len(first.seen) - 1} steps, the other {len(second.seen) - 1}"
    for step, (one, other) in enumerate(zip(first.seen, second.seen, strict=True)):
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
        found = (_difference(one[key], other[key], tolerance, f"{where}.{key}" if where else str(key)) for key in one)
        return next((text for text in found if text is not None), None)
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
