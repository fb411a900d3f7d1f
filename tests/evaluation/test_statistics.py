"""Intervals and tests of what was measured, against published tables and by exact computation."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from xpl_cli.evaluation.statistics import intervals as statistics
from xpl_cli.evaluation.statistics.intervals import (
    Estimate,
    PairedCounts,
    bootstrap,
    clopper_pearson,
    holm,
    mcnemar,
    newcombe,
    newcombe_paired,
    wilson,
)


@pytest.mark.parametrize(
    ("successes", "count", "by_score", "by_tails"),
    [
        (81, 263, (0.2553, 0.3662), (0.2527, 0.3676)),
        (15, 148, (0.0624, 0.1605), (0.0578, 0.1617)),
        (0, 20, (0.0000, 0.1611), (0.0000, 0.1684)),
        (1, 29, (0.0061, 0.1718), (0.0009, 0.1776)),
    ],
)
def test_intervals_of_a_share_are_those_of_published_tables(
    successes: int, count: int, by_score: tuple[float, float], by_tails: tuple[float, float]
) -> None:
    """Newcombe, Two-sided confidence intervals for the single proportion, Stat. Med. 17 (1998), table I."""
    assert wilson(successes / count, count) == pytest.approx(by_score, abs=5e-5)
    assert clopper_pearson(successes, count) == pytest.approx(by_tails, abs=5e-5)


@pytest.mark.parametrize(("mean", "count"), [(0.5, 0), (1.1, 3), (float("nan"), 3)])
def test_what_is_no_share_has_no_interval(mean: float, count: int) -> None:
    with pytest.raises(ValueError, match="at least one trial"):
        wilson(mean, count)


@pytest.mark.parametrize(
    ("first", "second", "low", "high"),
    [
        ((48, 80), (56, 70), 0.0524, 0.3339),
        ((3, 10), (9, 10), 0.1705, 0.8090),
        ((2, 7), (6, 7), 0.0582, 0.8062),
        ((0, 29), (5, 56), -0.0381, 0.1926),
        ((0, 20), (0, 10), -0.1611, 0.2775),
        ((0, 10), (0, 10), -0.2775, 0.2775),
        ((0, 20), (10, 10), 0.6791, 1.0000),
        ((0, 10), (10, 10), 0.6075, 1.0000),
    ],
)
def test_the_difference_of_independent_shares_is_that_of_published_tables(
    first: tuple[int, int], second: tuple[int, int], low: float, high: float
) -> None:
    """Newcombe, Interval estimation for the difference ..., Stat. Med. 17 (1998) 873-890, table II, method 10."""
    estimate = newcombe(_share(*first), _share(*second))
    assert estimate.interval == pytest.approx((low, high), abs=5e-5)


def test_the_paired_difference_is_that_of_a_published_example() -> None:
    """Fagerland, Lydersen, Laake, Statistical Analysis of Contingency Tables (2017), chapter 8: Cavo et al., 2012."""
    pairs = PairedCounts(both=59, only_first=16, only_second=6, neither=80)
    estimate = newcombe_paired(pairs)
    assert estimate.value == pytest.approx(-0.0621, abs=5e-5)
    assert estimate.interval == pytest.approx((-0.1186, -0.0046), abs=5e-5)
    assert mcnemar(pairs) == pytest.approx(0.052479, abs=5e-7)


def test_the_exact_test_is_that_of_published_examples() -> None:
    """Fagerland et al., chapter 8: Bentur et al., 2009; without discordant pairs there is no evidence."""
    assert mcnemar(PairedCounts(both=1, only_first=7, only_second=1, neither=12)) == pytest.approx(0.0703, abs=5e-5)
    assert mcnemar(PairedCounts(both=9, only_first=0, only_second=0, neither=11)) == 1.0


def test_pairing_narrows_the_interval_of_what_goes_together() -> None:
    """And exchanging the two subjects turns the difference round."""
    pairs = PairedCounts(both=25, only_first=2, only_second=6, neither=17)
    alone = newcombe(_share(27, 50), _share(31, 50))
    assert newcombe_paired(pairs).interval.width < alone.interval.width
    low, high = newcombe_paired(PairedCounts(pairs.both, pairs.only_second, pairs.only_first, pairs.neither)).interval
    assert newcombe_paired(pairs).interval == pytest.approx((-high, -low))


def test_the_paired_interval_has_its_nominal_coverage() -> None:
    """All tables of 20 pairs, weighted with their probability under rates that go together more or less."""
    from scipy import stats

    tables = [t for t in itertools.product(range(21), repeat=4) if sum(t) == 20]
    intervals = np.array([newcombe_paired(PairedCounts(*table)).interval for table in tables])
    for shares in ((0.5, 0.1, 0.2, 0.2), (0.25, 0.25, 0.25, 0.25), (0.7, 0.15, 0.05, 0.1), (0.3, 0.02, 0.18, 0.5)):
        chance = stats.multinomial(20, shares).pmf(np.array(tables))
        truth = shares[2] - shares[1]
        covered = chance[(intervals[:, 0] <= truth) & (truth <= intervals[:, 1])].sum()
        assert 0.93 < covered < 0.99, shares


def test_a_mean_of_cells_has_its_nominal_coverage() -> None:
    """Three tasks of 12 episodes each, by the probabilities of all their outcomes."""
    from scipy import stats

    shares = [_share(successes, 12) for successes in range(13)]
    for rates in ((0.5, 0.5, 0.5), (0.1, 0.5, 0.9), (0.02, 0.9, 0.95), (0.8, 0.9, 0.98)):
        chances = [stats.binom(12, rate).pmf(np.arange(13)) for rate in rates]
        covered = 0.0
        for successes in itertools.product(range(13), repeat=3):
            estimate = statistics.mean_estimate([shares[count] for count in successes])
            if np.mean(rates) in estimate.interval:
                covered += math.prod(chance[count] for chance, count in zip(chances, successes, strict=True))
        assert 0.92 < covered < 0.995, rates


def test_a_mean_of_one_is_that_one() -> None:
    """A summary of one cell has the same overall row; of none it has no figures."""
    estimate = statistics.mean_estimate([_share(3, 7)])
    assert estimate.value == 3 / 7
    assert estimate.interval == pytest.approx(wilson(3 / 7, 7))
    with pytest.raises(ValueError, match="at least one estimate"):
        statistics.mean_estimate([])
    with pytest.raises(ValueError, match="at least one pair"):
        newcombe_paired(PairedCounts(0, 0, 0, 0))


def test_p_values_are_raised_as_published() -> None:
    """Holm's procedure as R's p.adjust does it, in the order of the tests; equal ones stay equal."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([0.02, 0.02]) == [0.04, 0.04]
    assert holm([]) == []


def test_resampling_depends_on_the_values_only() -> None:
    scores = [0.0, 0.25, 0.25, 0.5, 0.5, 0.5, 0.75, 1.0, 1.0, 1.0, 1.0, 1.0]
    first = bootstrap(scores)
    assert bootstrap(reversed(scores)) == first
    assert first.low < np.mean(scores) < first.high


@pytest.mark.parametrize("scores", [[1.0] * 30, [0.5] * 30, [0.0, 1.0], [0.7]])
def test_values_without_a_spread_are_not_resampled(scores: list[float]) -> None:
    """Thirty perfect episodes do not prove perfection, which an interval without width would claim."""
    assert bootstrap(scores) == wilson(float(np.mean(scores)), len(scores))


def _share(successes: int, count: int) -> Estimate:
    return Estimate(successes / count, wilson(successes / count, count))
