"""Batch-size-dependent floating-point error: a GPU sums a batch of three in another order than a single observation.

Measured on an H100: answers of LeRobot's ACT in float32 differ by 1.3e-6 between a batch of one and of three. Half
precision is about a thousand times as coarse.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk
from xpl_cli.audit.served.compare import is_answer_list

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from xpl.contract import ObservationDict
    from xpl_cli.audit.served.recorded_client import Answer

    Ask = Callable[[Sequence[ObservationDict], list[int]], Answer]
    """Sends a batch of observations in a new episode, and gets the chunks of some environments."""

_COUNTS = range(1, 5)
"""Sizes of batches that rules compare."""
_TIMES = 5.0
"""Rounding differs between observations; this multiple of the measured one is allowed."""
OF_SPAN, _OF_SIZE = 0.02, 0.005
"""At most the larger of these shares: of the span of answers to different observations, and of their largest number.
Half precision rounds relative to the size of numbers; a division by the batch size exceeds both."""


def measure_rounding(ask: Ask, scenes: Sequence[ObservationDict]) -> dict[str, float]:
    """Measure batch-size-dependent floating-point error, for each key of an action.

    All environments of batches of several sizes get the same observation. The answers of one environment in all batches
    differ by rounding only. A policy that mixes up environments mixes equal ones here, so that its mistake is not taken
    for rounding. Two environments are not compared, because a policy that samples answers each differently. The largest
    share of any key counts for all keys: a gripper has too few numbers to measure it.

    Args:
        ask: returns the chunks for some environments after a batch of observations in a new episode.
        scenes: observations of several environments that differ.

    Returns:
        By key, in the key's unit; empty where the batches are not answered in one form.
    """
    values_by_key = _by_key([ask(scenes, [int(obs[sdk.Obs.ENV_IDX]) for obs in scenes])])
    if not values_by_key:
        return {}
    size = {key: float(np.abs(values).max(initial=0.0)) for key, values in values_by_key.items()}
    share = 0.0
    for scene in scenes:
        batches = [_answer_copies(ask, scene, count) for count in _COUNTS]
        if not all(map(is_answer_list, batches)):
            return {}
        for env in range(len(batches)):
            same_by_key = _by_key([batch[env : env + 1] for batch in batches[env:]])
            if same_by_key.keys() != values_by_key.keys():
                return {}
            share = max([share, *(_span(values) / size[key] for key, values in same_by_key.items() if size[key] > 0)])
    return {key: min(_TIMES * share * size[key], rounding_limit(values)) for key, values in values_by_key.items()}


def rounding_limit(values: np.ndarray) -> float:
    """Return the largest allowed difference of answers to equal observations in batches of other sizes.

    Args:
        values: answers of one key to different observations, the last axis its numbers: (N, ..., D).
    """
    return max(OF_SPAN * _span(values), _OF_SIZE * float(np.abs(values).max(initial=0.0)))


def _answer_copies(ask: Ask, scene: ObservationDict, count: int) -> Answer:
    envs = list(range(count))
    return ask([{**scene, sdk.Obs.ENV_IDX: env} for env in envs], envs)


def _span(values: np.ndarray) -> float:
    return float(np.ptp(values, axis=0).max(initial=0.0))


def _by_key(batches: Sequence[Answer]) -> dict[str, np.ndarray]:
    """Return the chunks of some batches by key, (chunks, steps, dimension); empty if their forms differ."""
    if not all(map(is_answer_list, batches)):
        return {}
    chunks = [chunk for batch in batches for chunk in batch]
    try:
        return {key: np.array([[step[key] for step in chunk] for chunk in chunks], float) for key in chunks[0][0]}
    except (KeyError, IndexError, TypeError, ValueError):
        return {}
