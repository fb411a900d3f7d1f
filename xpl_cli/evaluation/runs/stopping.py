"""The number of episodes: planned, or until the success rate is known well enough.

Stopping at a narrow interval looks at the data repeatedly, which costs some confidence: averaged over all rates, the
    final
interval still holds the true rate in 95 % of the runs, and at the least favourable rate in 92 % (for widths of at most
0.3). tests/evaluation/test_stopping.py computes that exactly.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING, Final

from xpl_cli.evaluation.statistics.intervals import wilson

if TYPE_CHECKING:
    from collections.abc import Iterable

FEWEST: Final = 20
"""Judged episodes before which nothing ends: a few successes in a row are no measurement yet."""


def stopping_point(outcomes: Iterable[bool | None], width: float) -> int | None:
    """Return after how many of a cell's episodes its success rate was known well enough, or None if it is not yet.

    The result depends on the order of the plan only. With several workers more episodes may have run; these do not
    count, so that the result depends neither on the number of workers nor on interruptions.

    Args:
        outcomes: of the cell's episodes in the order of the plan, up to the first that is not final: whether each
            succeeded, None for one that counts neither way.
        width: limit of the interval's width, above 0, at most 1.
    """
    successes = judged = 0
    for count, outcome in enumerate(outcomes, start=1):
        if outcome is None:
            continue
        judged += 1
        successes += outcome
        if judged >= FEWEST and wilson(successes / judged, judged).width <= width:
            return count
    return None


def episodes_needed(width: float, rate: float = 0.5) -> int:
    """Return how many episodes make the interval of a success rate no wider than `width`.

    Args:
        width: above 0, at most 1.
        rate: what is expected; no other needs as many episodes as 0.5.

    Raises:
        ValueError: if `width` is not in that range.
    """
    if not 0.0 < width <= 1.0:
        raise ValueError(f"an interval's width is above 0 and at most 1, got {width}")
    most = 4 / width**2  # at a rate of 0.5 the width is z / sqrt(n + z * z), and z is below 2
    return bisect_left(range(int(most) + 2), x=True, lo=1, key=lambda count: wilson(rate, count).width <= width)
