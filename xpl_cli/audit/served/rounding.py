"""How far batched kernels round: a GPU sums a batch of three in another order than a single observation.

Seen on an H100: LeRobot's ACT in float32 answers 1.3e-6 apart beside two others. Half precision is some thousand times
as coarse.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xpl import _spec as sdk
from xpl_cli.audit.served.compare import answers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

_SIZES = range(1, 5)
"""Sizes of batches that rules compare."""
_TIMES = 5.0
"""Other observations round otherwise; this many times what was seen is allowed."""
_SHARE = 0.02
"""And at most this share of what answers to different observations span: who divides by the batch is not excused."""


def measured(
    answered: Callable[[Sequence[dict[str, Any]], list[int]], Any], one: dict[str, Any], others: Sequence[dict[str, Any]]
) -> dict[str, float]:
    """Return by how much answers may differ between batches of other sizes, for each key of an action.

    One observation, shown to every environment of a batch, has one answer in batches of all sizes, and by what these
    differ is rounding. Who mixes environments up mixes equal ones here, and is allowed nothing by that.

    Args:
        answered: returns the chunks for some environments after a batch of observations in a new episode.
        one: the observation that all environments are shown.
        others: observations of several environments that differ, with its instruction.

    Returns:
        By key, in the key's unit; empty where the batches are not answered in one form.
    """
    alike: list[Any] = []
    for size in _SIZES:
        envs = list(range(size))
        alike.append(answered([{**one, sdk.Obs.ENV_IDX: env} for env in envs], envs))
    unlike = answered(others, [int(obs[sdk.Obs.ENV_IDX]) for obs in others])
    if not all(map(answers, (*alike, unlike))):
        return {}
    apart, span = _spans([chunk for answer in alike for chunk in answer]), _spans(unlike)
    return {key: min(_TIMES * apart[key], _SHARE * span[key]) for key in apart.keys() & span.keys()}


def _spans(chunks: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, float]:
    """Return how far chunks lie apart at most, for each key; nothing if they have different forms."""
    found = {}
    try:
        for key in chunks[0][0]:
            values = np.array([[step[key] for step in chunk] for chunk in chunks], float)
            found[key] = float(np.ptp(values, axis=0).max(initial=0.0))
    except (KeyError, IndexError, TypeError, ValueError):
        return {}
    return found
