"""How far batched kernels round: a GPU sums a batch of three in another order than a single observation.

Seen on an H100: LeRobot's ACT in float32 answers 1.3e-6 apart beside two others. Half precision is some thousand times
as coarse.
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
    """Shows a batch of observations in a new episode, and asks for the chunks of some environments."""

_COUNTS = range(1, 5)
"""Sizes of batches that rules compare."""
_TIMES = 5.0
"""Other observations round otherwise; this many times what was seen is allowed."""
OF_SPAN, _OF_SIZE = 0.02, 0.005
"""And at most the larger of these shares: of what answers to different observations span, and of the largest number in
them. Half precision rounds by the size of numbers; who divides by the batch is not excused."""


def measure_rounding(ask: Ask, scenes: Sequence[ObservationDict]) -> dict[str, float]:
    """Return by how much answers may differ between batches of other sizes, for each key of an action.

    One observation is shown to every environment of batches of several sizes. An environment has one answer in all of
    them, and by what these differ is rounding. Who mixes environments up mixes equal ones here, and is allowed nothing
    by that. Two environments are not compared: who samples has other answers for each. What is seen of one key holds
    for all, as a share of the largest number: a gripper has few numbers to see it by.

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
    """Return the most that answers to equal observations may differ by in batches of other sizes.

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
    """Return the chunks of some batches by key, (chunks, steps, dimension); nothing if their forms differ."""
    if not all(map(is_answer_list, batches)):
        return {}
    chunks = [chunk for batch in batches for chunk in batch]
    try:
        return {key: np.array([[step[key] for step in chunk] for chunk in chunks], float) for key in chunks[0][0]}
    except (KeyError, IndexError, TypeError, ValueError):
        return {}
