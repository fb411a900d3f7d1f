"""Running until the success rate is known well enough."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.checkout import ROOT
from xpl_cli.evaluation.runs.stopping import FEWEST, episodes_needed, stopping_point
from xpl_cli.evaluation.statistics.intervals import Interval, wilson


def test_a_cell_ends_with_the_first_interval_that_is_narrow_enough() -> None:
    outcomes = [True, False] * 40
    point = stopping_point(outcomes, 0.3)
    assert point is not None
    assert _interval(outcomes[:point]).width <= 0.3
    assert _interval(outcomes[: point - 1]).width > 0.3
    assert stopping_point(outcomes[: point - 1], 0.3) is None
    assert stopping_point(outcomes[:point], 0.3) == point


def test_episodes_that_count_neither_way_are_passed_over() -> None:
    """An infrastructure error narrows no interval and still takes one of the cell's episodes."""
    outcomes = [None, None, *[True, None] * 40]
    point = stopping_point([True] * 40, 0.15)
    assert point is not None
    assert stopping_point(outcomes, 0.15) == 2 + 2 * point - 1
    assert stopping_point([None] * 100, 1.0) is None


def test_a_few_successes_in_a_row_are_no_measurement() -> None:
    assert stopping_point([True] * 100, 1.0) == FEWEST


@pytest.mark.parametrize(("width", "rate", "count"), [(0.1, 0.5, 381), (0.2, 0.5, 93), (1.0, 0.5, 1), (0.1, 0.9, 141)])
def test_the_plan_names_the_fewest_episodes(width: float, rate: float, count: int) -> None:
    assert episodes_needed(width, rate) == count
    assert wilson(rate, count).width <= width
    assert count == 1 or wilson(rate, count - 1).width > width


def test_the_documentation_plans_as_the_tool_does() -> None:
    """docs/statistics.md: the table of episodes by width and rate."""
    page = (ROOT / "docs" / "statistics.md").read_text(encoding="utf-8")
    for width in (0.4, 0.3, 0.2, 0.1, 0.05):
        counts = (episodes_needed(width, rate) for rate in (0.5, 0.8, 0.9, 0.95))
        assert f"| {width} | {' | '.join(map(str, counts))} |" in page


@pytest.mark.parametrize("width", [0.0, -0.1, 1.5])
def test_no_plan_for_no_width(width: float) -> None:
    with pytest.raises(ValueError, match="above 0 and at most 1"):
        episodes_needed(width)


@pytest.mark.parametrize("width", [0.1, 0.2, 0.3, 0.35, 0.4, 1.0])
def test_the_interval_after_stopping_holds_the_true_rate_nearly_as_often(width: float) -> None:
    """Exactly, by following the probability of every count of successes until each has stopped."""
    rates = np.linspace(0.01, 0.99, 99)[:, None]
    alive, covered = np.ones_like(rates), np.zeros(len(rates))
    for judged in range(1, max(FEWEST, episodes_needed(width)) + 1):
        alive = np.pad(alive * (1 - rates), ((0, 0), (0, 1))) + np.pad(alive * rates, ((0, 0), (1, 0)))
        if judged < FEWEST:
            continue
        low, high = np.array([wilson(count / judged, judged) for count in range(judged + 1)]).T
        ends = high - low <= width
        covered += (alive * (ends & (low <= rates) & (rates <= high))).sum(axis=1)
        alive[:, ends] = 0.0
    assert alive.sum() == 0.0
    assert covered.mean() > 0.945
    assert covered.min() > 0.92


def _interval(outcomes: list[bool]) -> Interval:
    return wilson(sum(outcomes) / len(outcomes), len(outcomes))
