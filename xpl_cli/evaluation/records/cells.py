"""Which recorded episodes count, and for what: the cells of a run, one for each task and setting."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import TYPE_CHECKING, Final, TypeVar

from xpl.vector import INFRASTRUCTURE
from xpl_cli.evaluation.runs.stopping import stopping_point
from xpl_cli.evaluation.statistics.intervals import Estimate, Interval, PairedCounts, bootstrap, clopper_pearson, wilson

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from xpl_cli.evaluation.records.model import EpisodeOutcome, EpisodeRecord, PlannedCell
    from xpl_cli.evaluation.records.records import Run

FAILURES: Final = ("task", "policy", INFRASTRUCTURE)
INTERVAL_METHODS: Final[dict[str, Callable[[int, int], Interval]]] = {
    "wilson": lambda successes, count: wilson(successes / count, count),
    "exact": clopper_pearson,
}
"""Intervals of a success rate, by name."""

_Case = TypeVar("_Case")


@dataclass(frozen=True)
class Cell:
    """Episodes of one task in one setting.

    Attributes:
        task, setting, dimension, frozen: as in the plan.
        planned: number of seeds.
        counted: final lines, in the order of the plan.
        beyond: number of final lines that do not count, because the cell had ended before them.
        survived: episodes in which the policy's process had crashed in an earlier attempt.
        is_judged: whether any episode of the run defines success.
        ended: whether the success rate was known well enough before all seeds were run.
    """

    task: str
    setting: str
    dimension: str | None
    frozen: bool
    planned: int
    counted: tuple[EpisodeRecord, ...]
    beyond: int
    ended: bool
    survived: frozenset[int] = frozenset()
    is_judged: bool = False

    @property
    def remaining(self) -> int:
        """Number of episodes that have not run yet."""
        return 0 if self.ended else self.planned - len(self.counted)

    @property
    def outcomes(self) -> list[bool]:
        """Whether each episode succeeded that counts for the success rate."""
        return [success for success in map(outcome, self.counted) if success is not None]

    @property
    def certain(self) -> list[bool]:
        """Whether each episode counts as a success (`counts_as_success`); empty if no episode defines success."""
        return (
            [success for success in map(self.counts_as_success, self.counted) if success is not None]
            if self._defines_success
            else []
        )

    @property
    def scores(self) -> list[float]:
        """Scores of the episodes, 0 for infrastructure errors; empty if no episode has a score."""
        scores = [self.score(line) for line in self.counted if line.failure != INFRASTRUCTURE]
        defined = [score for score in scores if score is not None]
        tells = bool(defined) or (self.is_judged and not scores)
        return [*defined, *[0.0] * self.failed(INFRASTRUCTURE)] if tells else []

    @property
    def by_seed(self) -> dict[int, bool]:
        """Seed to whether the episode certainly succeeded."""
        successes = ((line.seed, self.counts_as_success(line)) for line in self.counted)
        return {seed: success for seed, success in successes if success is not None} if self._defines_success else {}

    @property
    def _defines_success(self) -> bool:
        """Whether success is defined; other cells of the run decide if all episodes are infrastructure errors."""
        is_silent = any(outcome(line) is None and line.failure != INFRASTRUCTURE for line in self.counted)
        return bool(self.outcomes) or (self.is_judged and not is_silent)

    def counts_as_success(self, line: EpisodeRecord) -> bool | None:
        """Return whether an episode of this cell succeeded beyond doubt (`counts_as_success`)."""
        return counts_as_success(line, self.survived)

    def score(self, line: EpisodeRecord) -> float | None:
        """Return the score of an episode of this cell; 0 if it was retried after a crash of the policy."""
        value = score(line)
        return value if value is None or line.index not in self.survived else 0.0

    def failed(self, kind: str) -> int:
        """Return the number of episodes whose failure is of this class."""
        return sum(line.failure == kind for line in self.counted)

    def success_rate(self, method: str) -> Estimate | None:
        """Return the success rate with an interval by one of INTERVAL_METHODS; None if no episode defines success."""
        outcomes = self.certain
        if not outcomes:
            return None
        return Estimate(sum(outcomes) / len(outcomes), INTERVAL_METHODS[method](sum(outcomes), len(outcomes)))

    def mean_score(self) -> Estimate | None:
        """Return the mean score; None if no episode has one."""
        scores = self.scores
        return Estimate(sum(scores) / len(scores), bootstrap(scores)) if scores else None


def outcome(line: EpisodeOutcome) -> bool | None:
    """Return whether an episode succeeded, or None if that is not defined."""
    if line.failure == INFRASTRUCTURE:
        return None
    return False if line.failure is not None else line.success


def counts_as_success(line: EpisodeRecord, survived: Collection[int]) -> bool | None:
    """Return whether an episode counts as a success, or None if the environment defines none.

    An attempt without a result must not help a policy: an episode counts as failed if each of its attempts ended with
    an infrastructure error, because the cause cannot be attributed, and if it succeeded only after the policy's process
    had crashed in an earlier attempt.

    Args:
        line: the final line.
        survived: episodes in which the policy's process had crashed before (`retried_after_crash`).
    """
    if line.failure == INFRASTRUCTURE:
        return False
    success = outcome(line)
    return success and line.index not in survived if success is not None else None


def retried_after_crash(attempts: Iterable[EpisodeRecord]) -> frozenset[int]:
    """Return the episodes that were retried because the policy's process had crashed."""
    return frozenset(line.index for line in attempts if line.failure == "policy" and not line.final)


def score(line: EpisodeOutcome) -> float | None:
    """Return an episode's score, or None if it has none; a policy that failed before there was one has 0."""
    if line.failure == INFRASTRUCTURE:
        return None
    return 0.0 if line.score is None and line.failure == "policy" else line.score


def paired_counts(first: Mapping[_Case, bool], second: Mapping[_Case, bool]) -> PairedCounts:
    """Return how often both, one or none succeeded, of the cases that two have in common."""
    counts = Counter((first[case], second[case]) for case in first.keys() & second.keys())
    return PairedCounts(counts[True, True], counts[True, False], counts[False, True], counts[False, False])


def cells(run: Run) -> list[Cell]:
    """Return the cells of a run in the order of its plan."""
    indices: dict[int, list[int]] = defaultdict(list)
    for slot in run.plan.slots():
        indices[slot.cell].append(slot.index)
    width, survived = run.plan.until_width, retried_after_crash(run.attempts)
    is_judged = any(outcome(line) is not None for line in run.finals.values())
    result = [
        _cell(planned, [run.finals.get(index) for index in indices[number]], width, survived)
        for number, planned in enumerate(run.plan.cells)
    ]
    return [replace(cell, is_judged=is_judged) for cell in result]


def _cell(
    planned: PlannedCell, finals: Sequence[EpisodeRecord | None], width: float | None, survived: frozenset[int]
) -> Cell:
    finished = [line for line in finals if line is not None]
    point = None
    if width is not None:
        leading = takewhile(lambda line: line is not None, finals)
        point = stopping_point((counts_as_success(line, survived) for line in leading if line is not None), width)
    counted = tuple(finished if point is None else finished[:point])
    return Cell(
        task=planned.task,
        setting=planned.setting,
        dimension=planned.dimension,
        frozen=planned.frozen,
        planned=len(finals),
        counted=counted,
        beyond=len(finished) - len(counted),
        ended=point is not None,
        survived=survived,
    )
