"""Comparison of answers with golden pairs in distribution, for a model that samples and takes no seed.

The test: of every number of every step, K answers of each to the same question. Means differ if Welch's statistic
passes the quantile of a normal distribution that equal ones pass once in a million audits (Bonferroni, over all numbers
that are looked at). Spreads differ if the logarithm of the ratio of variances, averaged over steps and
questions, does so; of normal numbers its standard deviation is sqrt(4 / (K - 1)) for one question, and it is taken
twice as large, since models are not normal. What is below the tolerance counts as equal in both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl_cli.model_io.difference import spreads

if TYPE_CHECKING:
    from xpl_cli.model_io.pairs import Answer, Chunk, PairSession

_ERRORS: Final = 1e-6
"""Audits of a right adapter in which a number differs by chance, at most."""
_HEAVY: Final = 2.0
"""How much wider a logarithm of variances may scatter than that of normal numbers."""


@dataclass(frozen=True)
class Shift:
    """A number of the action that has another distribution.

    Attributes:
        part: the number, such as left_ee_joint_state[0].
        question, step: where it shows most; step is None for spreads, which are of all.
        golden, answer: mean, or spread, of the two.
        what: `mean` or `spread`.
        sigmas: how many standard errors they lie apart.
        limit: how many are allowed.
        parts: all numbers with another distribution, the farthest first.
    """

    part: str
    question: int
    step: int | None
    golden: float
    answer: float
    statistic: str
    sigmas: float
    limit: float
    parts: tuple[str, ...]


def find_shift(session: PairSession, answers: Sequence[Sequence[Chunk]], share: float) -> Shift | None:
    """Return the clearest difference in distribution, None if there is none.

    Args:
        session: the golden answers.
        answers: the adapter's takes of each question.
        share: of the span of the golden answers that is no difference.
    """
    golden, other = _columns(session, answers)
    span = spreads([session.chunk(question, take) for question in session.questions for take in range(session.takes)])
    shifts = [*_means(golden, other, span, share), *_spreads(golden, other, span, share)]
    shifts = sorted((one for one in shifts if one.sigmas > one.limit), key=lambda one: -one.sigmas / one.limit)
    if not shifts:
        return None
    parts = tuple(dict.fromkeys(one.part for one in shifts))
    return Shift(**{**vars(shifts[0]), "parts": parts})


def average_takes(
    session: PairSession, adapter_takes: Sequence[Sequence[Chunk]]
) -> tuple[PairSession, list[Chunk], float]:
    """Return a session of one take, with the means of the golden answers, the adapter's means, and the noise.

    Returns:
        the noise is that of one take: the largest standard deviation of a number, as a share of the span of the means.
    """
    golden, other = _columns(session, adapter_takes)
    answers = iter(
        {key: values.mean(0, keepdims=True).astype(np.float32) for key, values in answer.items()} for answer in golden
    )
    calls = tuple(tuple(next(answers) for _ in call_answers) for call_answers in session.answers)
    means = session.with_answers(calls, takes=1)
    chunks = [
        [{key: values[:, step].mean(0).astype(np.float32) for key, values in answer.items()} for step in range(steps)]
        for answer in other
        for steps in [len(next(iter(answer.values()))[0])]
    ]
    span = spreads([means.chunk(question) for question in means.questions])
    noise = max(
        float(values[..., index].std(0).max()) / span[f"{key}[{index}]"]
        for answer in golden
        for key, values in answer.items()
        for index in range(values.shape[-1])
    )
    return means, chunks, noise


def _columns(session: PairSession, answers: Sequence[Sequence[Chunk]]) -> tuple[list[Answer], list[Answer]]:
    """Return golden and adapter answers of each question, (K, steps, numbers) by key, with quaternions of one sign.

    Of golden chunks that are longer than the adapter's, which hands on their beginning, as much is taken.
    """
    golden: list[Answer] = []
    other: list[Answer] = []
    for question, takes in zip(session.questions, answers, strict=True):
        steps = len(takes[0])
        one = {key: values[:, :steps].astype(np.float64) for key, values in question.answer.items()}
        two = {key: np.array([[step[key] for step in chunk] for chunk in takes], np.float64) for key in one}
        first = {key: values[:1] for key, values in one.items()}
        golden.append({key: _one_sign(key, values, first[key]) for key, values in one.items()})
        other.append({key: _one_sign(key, values, first[key]) for key, values in two.items()})
    return golden, other


def _one_sign(key: str, values: np.ndarray, first: np.ndarray) -> np.ndarray:
    if not key.endswith(sdk.State.EE_POSE):
        return values
    turn = slice(sdk.POSITION_DIM, sdk.POSE_DIM)
    sign = np.where((values[..., turn] * first[..., turn]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    return np.concatenate((values[..., : sdk.POSITION_DIM], values[..., turn] * sign), axis=-1)


def _means(golden: Sequence[Answer], other: Sequence[Answer], span: Mapping[str, float], share: float) -> list[Shift]:
    count = sum(values[0].size for answer in golden for values in answer.values())
    limit = _quantile(count)
    shifts = []
    for number, (one, two) in enumerate(zip(golden, other, strict=True)):
        for key in one:
            apart = np.abs(one[key].mean(0) - two[key].mean(0))
            error = np.sqrt(one[key].var(0, ddof=1) / len(one[key]) + two[key].var(0, ddof=1) / len(two[key]))
            for index in range(apart.shape[1]):
                part = f"{key}[{index}]"
                beyond = np.maximum(apart[:, index] - share * span[part], 0.0)
                sigmas = beyond / np.maximum(error[:, index], share * span[part] / limit)
                step = int(sigmas.argmax())
                golden_mean, mean = (float(values[key][:, step, index].mean()) for values in (one, two))
                shifts.append(Shift(part, number, step, golden_mean, mean, "mean", float(sigmas[step]), limit, ()))
    return shifts


def _spreads(golden: Sequence[Answer], other: Sequence[Answer], span: Mapping[str, float], share: float) -> list[Shift]:
    shifts = []
    widths = {key: values.shape[-1] for key, values in golden[0].items()}
    takes = len(next(iter(golden[0].values())))
    if takes < 2:
        return []
    scatter = _HEAVY * math.sqrt(4.0 / (takes - 1)) / math.sqrt(len(golden))
    limit = _quantile(sum(widths.values()))
    for key, width in widths.items():
        for index in range(width):
            part = f"{key}[{index}]"
            floor = (share * span[part]) ** 2
            ratios, ones, twos = [], [], []
            for one, two in zip(golden, other, strict=True):
                variances = [values[key][..., index].var(0, ddof=1) + floor for values in (one, two)]
                ratios.append(float(np.log(variances[1] / variances[0]).mean()))
                ones.append(float(np.sqrt(variances[0].mean())))
                twos.append(float(np.sqrt(variances[1].mean())))
            sigmas = abs(float(np.mean(ratios))) / scatter
            mean_one, mean_two = float(np.mean(ones)), float(np.mean(twos))
            shifts.append(Shift(part, 0, None, mean_one, mean_two, "spread", sigmas, limit, ()))
    return shifts


def _quantile(count: int) -> float:
    """Return how many standard errors a number of `count` equal ones passes once in a million audits."""
    return NormalDist().inv_cdf(1.0 - _ERRORS / 2 / max(1, count))
