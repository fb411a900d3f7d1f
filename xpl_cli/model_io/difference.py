"""Differences of answers from the golden ones: for each number of the action, as a share of the golden spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from xpl import _spec as spec

Step = Mapping[str, Any]
Answers = Sequence[Sequence[Step]]
"""Of each question its chunk of action steps."""
PartialAnswers = Sequence[Sequence[Step | None]]
"""The same; None for steps that are not known."""
Differences = Mapping[str, float]
"""By number of an action, such as left_ee_joint_state[0], the largest difference over all questions and steps."""


@dataclass(frozen=True)
class EpisodeAnswers:
    """The answers of one episode of one environment.

    Attributes:
        observations: oldest first.
        asked_at: indices of the observations after which an action was requested.
        golden: the golden answers.
        adapter: those of the adapter.
    """

    observations: Sequence[Any]
    asked_at: Sequence[int]
    golden: Answers
    adapter: Answers


_PLACES = (slice(0, spec.POSITION_DIM), slice(spec.POSITION_DIM, spec.POSE_DIM))


def columns(answers: Answers) -> dict[str, np.ndarray]:
    """Return by key all steps of all answers, (N, width) float64."""
    steps = [step for chunk in answers for step in chunk]
    return {key: np.stack([np.asarray(step[key], np.float64) for step in steps]) for key in steps[0]} if steps else {}


def spreads(golden: Answers) -> dict[str, float]:
    """Return by number of an action what its differences are measured by.

    That is the largest range that a number of the same key has in the golden answers; of poses positions count by
    themselves, and rotations. Where nothing moved it is 1.
    """
    result = {}
    for key, values in columns(golden).items():
        for group in _groups(key, values.shape[1]):
            largest = float(np.ptp(_one_sign(key, values)[:, group], axis=0).max(initial=0.0))
            for index in range(values.shape[1])[group]:
                result[f"{key}[{index}]"] = largest or 1.0
    return result


def differences(golden: Answers, given: PartialAnswers, spread: Mapping[str, float]) -> dict[str, float]:
    """Return the differences of answers from the golden ones.

    Quaternions of either sign are the same rotation. Steps that are not known, and numbers that are NaN, are left out,
    unless most are. A key that is missing, a chunk of another length, or a number that is infinite is infinitely far.

    Args:
        golden: the golden answers.
        given: the answers to the same questions.
        spread: of `spreads`.
    """
    if [len(chunk) for chunk in golden] != [len(chunk) for chunk in given]:
        return dict.fromkeys(spread, np.inf)
    pairs = [
        (golden_step, step)
        for one, other in zip(golden, given, strict=True)
        for golden_step, step in zip(one, other, strict=True)
    ]
    known_pairs = [(golden_step, step) for golden_step, step in pairs if step is not None]
    if 2 * len(known_pairs) < len(pairs):
        return dict.fromkeys(spread, np.inf)
    golden_step, adapter_columns = (
        columns([[one for one, _ in known_pairs]]),
        columns([[other for _, other in known_pairs]]),
    )
    result = {}
    for key, values in golden_step.items():
        other = adapter_columns.get(key)
        same = other is not None and other.shape == values.shape
        for index in range(values.shape[1]):
            part = f"{key}[{index}]"
            if other is None or not same:
                result[part] = np.inf
                continue
            far = np.abs(_align_signs(key, other, values)[:, index] - values[:, index]) / spread[part]
            result[part] = _largest(far)
    return result


def aligned_differences(golden: Sequence[Step], given: Sequence[Step]) -> dict[str, np.ndarray]:
    """Return by number of an action the differences of a chunk from the golden one, (steps,).

    Quaternions of either sign are the same rotation.
    """
    golden_columns, given_columns = columns([golden]), columns([given])
    result = {}
    for key, values in golden_columns.items():
        far = _align_signs(key, given_columns[key], values) - values
        result.update({f"{key}[{index}]": far[:, index] for index in range(values.shape[1])})
    return result


def _largest(shares: np.ndarray) -> float:
    finite = shares[~np.isnan(shares)]
    return float(finite.max(initial=0.0)) if 3 * len(finite) >= len(shares) else np.inf


def _groups(key: str, width: int) -> Sequence[slice]:
    return _PLACES if key.endswith(spec.State.EE_POSE) else (slice(0, width),)


def _align_signs(key: str, values: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return poses whose quaternions have the sign that is nearer to others."""
    if not key.endswith(spec.State.EE_POSE):
        return values
    turn = values[:, _PLACES[1]]
    sign = np.where((turn * to[:, _PLACES[1]]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    return np.concatenate((values[:, _PLACES[0]], turn * sign), axis=-1)


def _one_sign(key: str, values: np.ndarray) -> np.ndarray:
    return _align_signs(key, values, np.broadcast_to(values[:1], values.shape)) if len(values) else values
