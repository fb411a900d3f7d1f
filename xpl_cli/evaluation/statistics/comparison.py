"""Compare two runs on their common episodes: `xpl.comparison/1` (spec/v1/comparison.schema.json).

Equal tasks, settings and seeds are equal cases, so that easy seeds help both alike. The exact McNemar test uses the
cases in which only one of the two succeeded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import mock_settings
from xpl_cli.evaluation.records.cells import cells, paired_counts
from xpl_cli.evaluation.statistics import caveats, intervals, verdicts
from xpl_cli.evaluation.statistics.comparison_model import (
    ComparedRun,
    Comparison,
    ComparisonMethods,
    ComparisonRow,
    UnpairedEpisodes,
)
from xpl_cli.evaluation.statistics.intervals import Estimate, Interval, PairedCounts
from xpl_cli.evaluation.statistics.run_differences import find_differences

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run


class IncomparableError(UserError):
    """Two runs whose results cannot be compared."""

    def __init__(self, message: str) -> None:
        hint = "run both in the same environment, on the same tasks and seeds"
        super().__init__(message, hint=hint, code=ExitCode.NOT_RUN)


@dataclass(frozen=True)
class _Matches:
    """Episodes of one task and setting that both runs finished; those with an infrastructure error count as failed.

    Attributes:
        task, setting: of the episodes.
        lines: of the first run and of the second, for each common seed.
        successes: whether each of the two counts as a success, for each common seed.
        scores: of each of the two, for each common seed; None if it has none.
    """

    task: str
    setting: str
    lines: Sequence[tuple[EpisodeRecord, EpisodeRecord]]
    successes: Sequence[tuple[bool, bool]]
    scores: Sequence[tuple[float | None, float | None]]

    @property
    def pairs(self) -> PairedCounts:
        """How often both, one or none succeeded."""
        first, second = (dict(enumerate(pair[side] for pair in self.successes)) for side in (0, 1))
        return paired_counts(first, second)

    def score_difference(self) -> Estimate | None:
        """Return by how much the second run's mean score exceeds the first's; None where scores are missing."""
        gains = [second - first for first, second in self.scores if first is not None and second is not None]
        if not gains:
            return None
        # The bootstrap is of values in 0..1.
        low, high = intervals.bootstrap((gain + 1) / 2 for gain in gains)
        return Estimate(sum(gains) / len(gains), Interval(2 * low - 1, 2 * high - 1))


def compare(first: Run, second: Run) -> Comparison:
    """Return the comparison of two runs, finished or not.

    Raises:
        IncomparableError: the environments differ, there is no common episode, or equal seeds have different layouts.
    """
    sides = (first.plan, second.plan)
    names = [plan.environment.name for plan in sides]
    if names[0] != names[1]:
        raise IncomparableError(f"the runs have different environments: {names[0]} and {names[1]}")
    matches = _matches(first, second)
    if not matches:
        raise IncomparableError("the runs have no episode in common: no equal task, setting and seed")
    _require_equal_layouts(matches)
    rows = [_row(match.task, match.setting, [match]) for match in matches]
    raised = intervals.holm([row.p_value for row in rows])
    compared = sum(len(match.lines) for match in matches)
    result = Comparison(
        first=_side(first),
        second=_side(second),
        confidence=intervals.CONFIDENCE,
        methods=ComparisonMethods(),
        differences=find_differences(first, second),
        left_out=UnpairedEpisodes(_counted_episodes(first) - compared, _counted_episodes(second) - compared),
        same_trajectories=sum(_is_same(one, other) for match in matches for one, other in match.lines),
        known_layouts=sum(_has_layouts(*pair) for match in matches for pair in match.lines),
        cells=[replace(row, adjusted_p_value=value) for row, value in zip(rows, raised, strict=True)],
        overall=_row(None, None, matches),
    )
    stops = any(plan.until_width is not None for plan in sides)
    unreal = mock_settings.remark(names[0], (match.setting for match in matches))
    notes = [
        *([] if unreal is None else [unreal]),
        *caveats.of_skipped((*first.skipped, *second.skipped)),
        *verdicts.notes(result, stops=stops),
    ]
    return replace(result, verdict=verdicts.verdict(result), notes=notes)


def _matches(first: Run, second: Run) -> list[_Matches]:
    """Return the episodes that both have, in the order of the first plan; cells without any are left out."""
    others = {(cell.task, cell.setting): cell for cell in cells(second)}
    matches = []
    for cell in cells(first):
        other = others.get((cell.task, cell.setting))
        if other is None:
            continue
        ends, lines = (cell.by_seed, other.by_seed), (_by_seed(cell.counted), _by_seed(other.counted))
        common = [seed for seed in ends[0] if seed in ends[1]]
        if common:
            pairs = [(lines[0][seed], lines[1][seed]) for seed in common]
            successes = [(ends[0][seed], ends[1][seed]) for seed in common]
            scores = [(cell.score(one), other.score(two)) for one, two in pairs]
            matches.append(_Matches(cell.task, cell.setting, pairs, successes, scores))
    return matches


def _by_seed(lines: Iterable[EpisodeRecord]) -> dict[int, EpisodeRecord]:
    return {line.seed: line for line in lines}


def _require_equal_layouts(matches: Sequence[_Matches]) -> None:
    """Raise unless equal seeds have equal layouts, as far as these are recorded."""
    unlike = [
        (match, first.seed)
        for match in matches
        for first, second in match.lines
        if _has_layouts(first, second) and first.layout != second.layout
    ]
    if unlike:
        match, seed = unlike[0]
        raise IncomparableError(
            f"equal seeds are not equal cases: in {len(unlike)} common episodes the layouts differ, first in "
            f"{match.task} ({match.setting}), seed {seed}"
        )


def _row(task: str | None, setting: str | None, matches: Sequence[_Matches]) -> ComparisonRow:
    """Return the row of one task and setting, or of all."""
    tables = [match.pairs for match in matches]
    pairs = PairedCounts(*map(sum, zip(*tables, strict=True)))
    success = intervals.mean_estimate([intervals.newcombe_paired(table) for table in tables])
    scores = [difference for match in matches if (difference := match.score_difference()) is not None]
    gain = intervals.mean_estimate(scores) if scores else None
    return ComparisonRow(
        task=task,
        setting=setting,
        pairs=pairs.total,
        **pairs._asdict(),
        first_rate=_mean((table.both + table.only_first) / table.total for table in tables),
        second_rate=_mean((table.both + table.only_second) / table.total for table in tables),
        difference=success.value,
        interval=success.interval,
        p_value=intervals.mcnemar(pairs),
        score_difference=gain and gain.value,
        score_interval=gain and gain.interval,
    )


def _side(run: Run) -> ComparedRun:
    plan = run.plan
    return ComparedRun(
        folder=str(run.folder),
        run=plan.run,
        policy=plan.policy.name,
        checkpoint=plan.policy.weights,
        environment=plan.environment.name,
        embodiment=plan.embodiment,
        action_type=plan.action_type,
    )


def _counted_episodes(run: Run) -> int:
    return sum(len(cell.counted) for cell in cells(run))


def _is_same(first: EpisodeRecord, second: EpisodeRecord) -> bool:
    return first.digest is not None and first.digest == second.digest


def _has_layouts(first: EpisodeRecord, second: EpisodeRecord) -> bool:
    return first.layout is not None and second.layout is not None


def _mean(values: Iterable[float]) -> float:
    numbers = list(values)
    return sum(numbers) / len(numbers)
