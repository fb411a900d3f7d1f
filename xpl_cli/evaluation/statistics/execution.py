"""Execution of a run: time, retries, latency, errors. Unlike results, they differ if the run is repeated."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from xpl.vector import INFRASTRUCTURE
from xpl_cli.evaluation.statistics import caveats
from xpl_cli.evaluation.statistics.summary_model import ErrorCount, ExecutionStats, Latency

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.evaluation.records.records import Run


def execution_stats(run: Run, beyond: int) -> ExecutionStats:
    """Return what all attempts at a run's episodes took.

    Args:
        run: its record.
        beyond: number of final episodes that do not count, because their cell had ended before them.
    """
    machines = len({line.machine for line in run.attempts})
    retried = [line for line in run.attempts if not line.final]
    with_errors = {line.index for line in retried if line.failure == INFRASTRUCTURE}
    recovered = sum(bool(line.success) and line.index in with_errors for line in run.finals.values())
    errors = Counter((line.failure, line.error) for line in run.attempts if line.error)
    return ExecutionStats(
        attempts=len(run.attempts),
        retried=len(retried),
        beyond=beyond,
        wall_seconds=math.fsum(line.wall_seconds for line in run.attempts),
        machines=machines,
        inference=_inference(run),
        errors=[ErrorCount(failure, error, count) for (failure, error), count in errors.most_common()],
        notes=caveats.of_execution(beyond, machines, recovered),
    )


def bin_edge(position: float) -> float:
    """Return the time in s at a place in a histogram of the schema: 0 is the beginning of its first bin."""
    return float(0.001 * 2.0 ** (position / 2))


def _inference(run: Run) -> Latency:
    """Return the round trips of all attempts together."""
    inferences = [line.inference for line in run.attempts if line.inference]
    histograms = [inference.histogram for inference in inferences if inference.histogram]
    bins = [0] * max(map(len, histograms), default=0)
    for histogram in histograms:
        for index, count in enumerate(histogram):
            bins[index] += count
    return Latency(
        count=sum(inference.count for inference in inferences),
        seconds=math.fsum(inference.seconds for inference in inferences),
        histogram=bins,
        p50=_quantile(bins, 0.5),
        p95=_quantile(bins, 0.95),
        p99=_quantile(bins, 0.99),
    )


def _quantile(bins: Sequence[int], share: float) -> float | None:
    """Return the time in s below which this share of the round trips lies, interpolated within a bin."""
    target, below = share * sum(bins), 0
    for index, count in enumerate(bins):
        if count and below + count >= target:
            return bin_edge(index + (target - below) / count)
        below += count
    return None
