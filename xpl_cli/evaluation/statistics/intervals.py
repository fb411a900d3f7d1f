"""How sure a measured share, mean or difference is, with 95 % confidence.

scipy is imported where it is needed: its import takes longer than `xpl --help`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

CONFIDENCE: Final = 0.95
RESAMPLES: Final = 2000
"""Draws of the bootstrap: the ends of an interval move by about a fiftieth of its width from one seed to another."""

FEWEST_RESAMPLED: Final = 10
"""Fewer values than these are too few for the bootstrap."""

MOST_CORRECTED: Final = 1000
"""More values than these need no correction for skewness, whose cost grows with their square."""

_Z: Final = 1.959963984540054
"""Two-sided 95 % quantile of the standard normal distribution."""


class Interval(NamedTuple):
    """A confidence interval.

    Attributes:
        low, high: its ends; of a share or mean in 0..1, of a difference in -1..1.
    """

    low: float
    high: float

    def __contains__(self, value: object) -> bool:
        return isinstance(value, (int, float)) and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"{self.low:.0%} to {self.high:.0%}"

    @property
    def width(self) -> float:
        """Distance of its ends."""
        return self.high - self.low


class Estimate(NamedTuple):
    """What was measured, and where it lies.

    Attributes:
        value: a share, mean or difference.
        interval: where it lies with 95 % confidence.
    """

    value: float
    interval: Interval


class PairedCounts(NamedTuple):
    """Outcomes of two subjects that met the same cases.

    Attributes:
        both, only_first, only_second, neither: numbers of cases in which these succeeded.
    """

    both: int
    only_first: int
    only_second: int
    neither: int

    @property
    def total(self) -> int:
        """Number of cases."""
        return sum(self)


def wilson(mean: float, count: int) -> Interval:
    """Return the interval of a mean of values in 0..1, by the score method.

    It is exact enough for shares of few trials, none or all included, where the usual mean plus and minus two standard
    errors is not. For values between 0 and 1, such as scores, it is wider than needed: no distribution of a mean m has
    a greater variance than the shares it is made for, m (1 - m). scipy knows it for whole numbers of successes only.

    Source: E. B. Wilson, Probable Inference, the Law of Succession, and Statistical Inference, JASA 22 (1927).

    Args:
        mean: share of successes, or mean score.
        count: number of trials.

    Raises:
        ValueError: if there is no trial, or the mean lies outside 0..1.
    """
    if count < 1 or not 0.0 <= mean <= 1.0:
        raise ValueError(f"an interval needs a mean in 0..1 of at least one trial, got {mean} of {count}")
    square = _Z * _Z / count
    middle = (mean + square / 2) / (1 + square)
    half = _Z * math.sqrt(mean * (1 - mean) / count + square / (4 * count)) / (1 + square)
    # At 0 and 1 the end is the mean itself, whatever rounding makes of it.
    return Interval(min(mean, max(0.0, middle - half)), max(mean, min(1.0, middle + half)))


def clopper_pearson(successes: int, count: int) -> Interval:
    """Return the interval of a share that holds it with 95 % confidence or more, whatever the share is.

    Source: C. J. Clopper, E. S. Pearson, The Use of Confidence or Fiducial Limits Illustrated in the Case of the
    Binomial, Biometrika 26 (1934).

    Raises:
        ValueError: if there is no trial, or more successes than trials.
    """
    from scipy.stats import binomtest

    interval = binomtest(successes, count).proportion_ci(CONFIDENCE, method="exact")
    return Interval(float(interval.low), float(interval.high))


def bootstrap(values: Iterable[float]) -> Interval:
    """Return the interval of the mean of values in 0..1 by the bootstrap (bias-corrected and accelerated).

    Equal values give equal intervals, in whatever order. Values that are all equal, and fewer than ten, do not show
    their spread: they get the wider interval of `wilson`.

    Source: B. Efron, Better Bootstrap Confidence Intervals, JASA 82 (1987).

    Raises:
        ValueError: there is no value.
    """
    import numpy as np

    drawn = np.sort(np.fromiter(values, dtype=np.float64))
    if len(drawn) < FEWEST_RESAMPLED or drawn[0] == drawn[-1]:
        return wilson(float(drawn.mean()) if len(drawn) else 0.0, len(drawn))
    from scipy.stats import bootstrap as resample

    interval = resample(
        (drawn,),
        np.mean,
        n_resamples=RESAMPLES,
        batch=200,  # draws at once, whose values lie in memory together
        confidence_level=CONFIDENCE,
        method="BCa" if len(drawn) <= MOST_CORRECTED else "percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Interval(float(interval.low), float(interval.high))


def mean_estimate(estimates: Sequence[Estimate]) -> Estimate:
    """Return the mean of estimates that are independent of each other, each of the same weight.

    Source for shares: G. Zou, W. Huang, X. Zhang, A Note on Confidence Interval Estimation for a Linear Function of
    Binomial Proportions, Computational Statistics and Data Analysis 53 (2009).

    Raises:
        ValueError: if there is none.
    """
    if not estimates:
        raise ValueError("a mean needs at least one estimate")
    count = len(estimates)
    value = math.fsum(estimate.value for estimate in estimates) / count
    below = math.hypot(*(estimate.value - estimate.interval.low for estimate in estimates)) / count
    above = math.hypot(*(estimate.interval.high - estimate.value for estimate in estimates)) / count
    return Estimate(value, Interval(value - below, value + above))


def newcombe(first: Estimate, second: Estimate, correlation: float = 0.0) -> Estimate:
    """Return second minus first.

    Source for shares: R. G. Newcombe, Interval Estimation for the Difference between Independent Proportions,
    Statistics in Medicine 17 (1998) 873-890, method 10.

    Args:
        first: what is taken away.
        second: what it is taken from.
        correlation: of the two, where they were measured on the same cases, -1..1.
    """

    def distance(one: float, other: float) -> float:
        # Of two errors that are fully correlated the smaller one cancels; rounding must not make the rest negative.
        return math.sqrt(max(0.0, one * one - 2 * correlation * one * other + other * other))

    value = second.value - first.value
    below = distance(second.value - second.interval.low, first.interval.high - first.value)
    above = distance(second.interval.high - second.value, first.value - first.interval.low)
    return Estimate(value, Interval(value - below, value + above))


def newcombe_paired(pairs: PairedCounts) -> Estimate:
    """Return by how much the second subject's success rate exceeds the first's, on the same cases.

    Source: R. G. Newcombe, Improved Confidence Intervals for the Difference between Binomial Proportions Based on
    Paired Data, Statistics in Medicine 17 (1998) 2635-2650, method 10.

    Raises:
        ValueError: if there is no pair.
    """
    count = pairs.total
    if not count:
        raise ValueError("a paired difference needs at least one pair")
    first, second = (
        Estimate(successes / count, wilson(successes / count, count))
        for successes in (pairs.both + pairs.only_first, pairs.both + pairs.only_second)
    )
    return newcombe(first, second, _correlation(pairs))


def mcnemar(pairs: PairedCounts) -> float:
    """Return the two-sided p-value of "neither is better" by the exact test of the cases in which only one succeeded.

    Source: Q. McNemar, Note on the Sampling Error of the Difference between Correlated Proportions or Percentages,
    Psychometrika 12 (1947); in its exact form it is a sign test.
    """
    from scipy.stats import binomtest

    discordant = pairs.only_first + pairs.only_second
    return float(binomtest(pairs.only_first, discordant).pvalue) if discordant else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values of several tests, raised so that any false alarm among them is as rare as one of one test.

    Source: S. Holm, A Simple Sequentially Rejective Multiple Test Procedure, Scandinavian Journal of Statistics 6
    (1979).
    """
    raised, least = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        least = max(least, min(1.0, (len(p_values) - rank) * p_values[index]))
        raised[index] = least
    return raised


def _correlation(pairs: PairedCounts) -> float:
    """Return the coefficient phi of the fourfold table, corrected for continuity as Newcombe's method 10 wants it."""
    both, only_first, only_second, neither = pairs
    agreement: float = both * neither - only_first * only_second
    if agreement > 0:
        agreement = max(0.0, agreement - pairs.total / 2)
    margins = (both + only_first) * (both + only_second) * (neither + only_first) * (neither + only_second)
    return agreement / math.sqrt(margins) if margins else 0.0
