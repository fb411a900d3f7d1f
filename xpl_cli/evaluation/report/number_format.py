"""Numbers as the page writes them."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from xpl_cli.evaluation.statistics.wording import NOTHING

if TYPE_CHECKING:
    from collections.abc import Sequence

_UNITS = ((86400, "d"), (3600, "h"), (60, "min"), (1, "s"))
_SPACE = "\N{NARROW NO-BREAK SPACE}"
_MINUS = "\N{MINUS SIGN}"


def between(interval: Sequence[float] | None, digits: int, scale: float = 1) -> str:
    """Return an interval: 0.57 to 0.85; nothing where there is none."""
    return "" if interval is None else f"{scale * interval[0]:.{digits}f} to {scale * interval[1]:.{digits}f}"


def points(difference: float) -> str:
    """Return a difference of shares in points: +12, or a true minus sign before 3."""
    # The addition makes 0 of -0, which rounding gives for a little less than nothing.
    return f"{round(100 * difference) + 0:+d}".replace("-", _MINUS)


def milliseconds(seconds: float | None) -> str:
    """Return a short time with its unit: 45 ms, 1.02 s."""
    if seconds is None:
        return NOTHING
    return f"{1000 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def duration(seconds: float) -> str:
    """Return a long time: 2 h 5 min, 3 min 20 s, 12 s."""
    for (unit, name), (smaller, small) in itertools.pairwise(_UNITS):
        if seconds >= unit:
            whole, rest = divmod(round(seconds / smaller), unit // smaller)
            return f"{whole} {name} {rest} {small}"
    return f"{seconds:.0f} s"


def many(count: int, noun: str) -> str:
    """Return a number with its noun: 1 step, 12 345 steps."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}".replace(",", _SPACE)
