"""The latency of get_action in the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.evaluation.report import figures
from xpl_cli.evaluation.report.number_format import many, milliseconds
from xpl_cli.evaluation.statistics.execution import bin_edge

if TYPE_CHECKING:
    from markupsafe import Markup

    from xpl_cli.evaluation.statistics.summary_model import Latency

_STEP = 2
"""Bins from one label to the next: every other edge doubles the time."""


@dataclass(frozen=True)
class LatencyView:
    """A histogram, its sentence, and the edges of its bins that are labelled."""

    said: str
    figure: Markup
    ticks: list[str]


def view(inference: Latency) -> LatencyView | None:
    """Return the histogram without its empty ends, with its sentence and the edges of its bins; None without any."""
    counts = inference.histogram
    filled = [index for index, count in enumerate(counts) if count]
    if not filled:
        return None
    # Even in number, so that the edges that are labelled are whole doublings.
    first = filled[0] - filled[0] % _STEP
    last = min(len(counts), filled[-1] + _STEP - filled[-1] % _STEP)
    caption = (
        f"Round trips of get_action as the environment's side saw them: {many(inference.count, 'request')}, median "
        f"{milliseconds(inference.p50)}, 95 % within {milliseconds(inference.p95)}, 99 % within "
        f"{milliseconds(inference.p99)}."
    )
    edges = range(first, last + 1, _STEP)
    return LatencyView(
        caption, figures.columns(counts[first:last], caption), [milliseconds(bin_edge(index)) for index in edges]
    )
