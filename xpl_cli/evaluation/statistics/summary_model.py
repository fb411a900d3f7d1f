"""The summary of a run, as spec/v1/summary.schema.json has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from xpl_cli.evaluation.statistics.documents import JsonDocument

if TYPE_CHECKING:
    from xpl_cli.evaluation.statistics.intervals import Interval


@dataclass(frozen=True)
class Latency:
    """The round trips of all attempts together.

    Attributes:
        count, seconds, histogram: as in a record.
        p50, p95, p99: time in s that a share of them did not exceed; None without any.
    """

    count: int
    seconds: float
    histogram: Sequence[int]
    p50: float | None
    p95: float | None
    p99: float | None


@dataclass(frozen=True)
class ErrorCount:
    """What ended attempts, whose failure it was, and how often."""

    failure: str | None
    error: str
    count: int


@dataclass(frozen=True)
class ExecutionStats:
    """What all attempts at a run's episodes took.

    Attributes:
        attempts: number of them.
        retried: how many were made again.
        beyond: final episodes that do not count, because their cell had ended before them.
        wall_seconds: of all attempts, one after the other.
        machines: number of machines, or sets of library versions.
        inference: round trips to the policy.
        errors: the most frequent first.
        notes: what else should be known of it, in sentences.
    """

    attempts: int
    retried: int
    beyond: int
    wall_seconds: float
    machines: int
    inference: Latency
    errors: Sequence[ErrorCount]
    notes: Sequence[str]


@dataclass(frozen=True)
class SummaryRow:
    """Figures of one cell or of several.

    Attributes:
        task, setting, dimension: common value of its cells; None if they differ.
        planned, completed, remaining: numbers of episodes.
        judged, successes: numbers of episodes that define success, and that succeeded.
        success_rate, success_interval: infrastructure errors count as failed; None if no episode defines success.
        infrastructure_bounds: the rate if all episodes with an infrastructure error had failed, and if all had
            succeeded; None if there is none.
        mean_score, score_interval: None if no episode has a score.
        failures: number of episodes by class of failure.
        mean_steps: control steps of an episode.
        corrections: number of corrected steps by kind of correction.
    """

    task: str | None
    setting: str | None
    dimension: str | None
    planned: int
    completed: int
    remaining: int
    judged: int
    successes: int
    success_rate: float | None
    success_interval: Interval | None
    infrastructure_bounds: tuple[float, float] | None
    mean_score: float | None
    score_interval: Interval | None
    failures: Mapping[str, int]
    mean_steps: float | None
    corrections: Mapping[str, int]


@dataclass(frozen=True)
class Contrast:
    """By how much a setting's success rate exceeds the first one's.

    Attributes:
        task: None for the mean over the tasks.
        settings: the first one, and the other.
        pairs: seeds that both have, by which they are compared; 0: none, compared as independent.
        difference, interval: None where it is not known.
    """

    task: str | None
    settings: tuple[str, str]
    pairs: int
    difference: float | None
    interval: Interval | None


@dataclass(frozen=True)
class SummaryMethods:
    """How intervals were computed."""

    success: str
    score: str


@dataclass(frozen=True)
class Summary(JsonDocument):
    """The summary of a run.

    Attributes:
        run, policy, environment, embodiment, action_type, until_width: as in its plan.
        confidence, methods: of every interval.
        cells: one row for each task and setting, in the order of the plan.
        tasks, settings, dimensions, overall: rows over several cells.
        contrasts: settings against the first one.
        execution: what all attempts took.
        notes: what the data do not show, in sentences.
    """

    schema: ClassVar[str] = "xpl.summary/1"

    run: str
    policy: str
    environment: str
    embodiment: str
    action_type: str
    until_width: float | None
    confidence: float
    methods: SummaryMethods
    cells: Sequence[SummaryRow]
    tasks: Sequence[SummaryRow]
    settings: Sequence[SummaryRow]
    dimensions: Sequence[SummaryRow]
    overall: SummaryRow
    contrasts: Sequence[Contrast]
    execution: ExecutionStats
    notes: Sequence[str] = ()
