"""The summary of a run: `xpl.summary/1` (spec/v1/summary.schema.json), computed from its record alone.

Rows over several cells are means of the cells' values: each weighs the same, whatever its number of episodes. If all
cells have equally many, that equals the value over all episodes.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, TypeVar

from xpl.vector import INFRASTRUCTURE
from xpl_cli.evaluation.records import run_mode
from xpl_cli.evaluation.records.cells import FAILURES, Cell, cells, paired_counts
from xpl_cli.evaluation.statistics import caveats, intervals
from xpl_cli.evaluation.statistics.execution import execution_stats
from xpl_cli.evaluation.statistics.summary_model import Contrast, Summary, SummaryMethods, SummaryRow

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.statistics.intervals import Estimate

SCORE_METHOD: Final = "bootstrap"

_T = TypeVar("_T")


@dataclass(frozen=True)
class _CellEstimates:
    """A cell, and its estimates, which take long enough to be made once."""

    cell: Cell
    success: Estimate | None
    score: Estimate | None


def summarise(run: Run, method: str = "wilson") -> Summary:
    """Return the summary of a run, finished or not.

    Args:
        run: its record.
        method: of the success rates' intervals: one of `cells.INTERVAL_METHODS`.
    """
    run_cells, plan = cells(run), run.plan
    measured = [_CellEstimates(cell, cell.success_rate(method), cell.mean_score()) for cell in run_cells]
    summary = Summary(
        run=plan.run,
        policy=plan.policy.name,
        environment=plan.environment.name,
        embodiment=plan.embodiment,
        action_type=plan.action_type,
        until_width=plan.until_width,
        confidence=intervals.CONFIDENCE,
        methods=SummaryMethods(method, SCORE_METHOD),
        cells=[_row([estimates]) for estimates in measured],
        tasks=_rows(measured, lambda cell: cell.task),
        settings=_rows(measured, lambda cell: cell.setting),
        dimensions=_rows(measured, lambda cell: cell.dimension),
        overall=_row(measured),
        contrasts=_contrasts(run_cells),
        execution=execution_stats(run, sum(cell.beyond for cell in run_cells)),
    )
    instruction_notes = caveats.of_instruction(run_mode.run_mode_of(plan).instruction)
    return replace(
        summary, notes=[*instruction_notes, *caveats.of_skipped(run.skipped), *caveats.of_summary(summary, run_cells)]
    )


def _rows(measured: Sequence[_CellEstimates], name: Callable[[Cell], str | None]) -> list[SummaryRow]:
    """Return a row for each group of cells of one name; cells without one are in none."""
    groups: dict[str, list[_CellEstimates]] = {}
    for estimates in measured:
        if (group_name := name(estimates.cell)) is not None:
            groups.setdefault(group_name, []).append(estimates)
    return [_row(group) for group in groups.values()]


def _row(measured: Sequence[_CellEstimates]) -> SummaryRow:
    """Return the row of one cell or of several."""
    members = [estimates.cell for estimates in measured]
    success, score = (
        _mean(estimates.success for estimates in measured),
        _mean(estimates.score for estimates in measured),
    )
    # Steps and corrections of the episodes without an infrastructure error.
    lines = [line for cell in members for line in cell.counted if line.failure != INFRASTRUCTURE]
    steps = [line.steps for line in lines if line.steps is not None]
    corrections: Counter[str] = Counter()
    for line in lines:
        corrections.update(line.corrections or {})
    return SummaryRow(
        task=_common_value(cell.task for cell in members),
        setting=_common_value(cell.setting for cell in members),
        dimension=_common_value(cell.dimension for cell in members),
        planned=sum(cell.planned for cell in members),
        completed=sum(len(cell.counted) for cell in members),
        remaining=sum(cell.remaining for cell in members),
        judged=sum(len(cell.outcomes) for cell in members),
        successes=sum(sum(cell.outcomes) for cell in members),
        success_rate=success and success.value,
        success_interval=success and success.interval,
        infrastructure_bounds=_infrastructure_bounds(members),
        mean_score=score and score.value,
        score_interval=score and score.interval,
        failures={kind: sum(cell.failed(kind) for cell in members) for kind in FAILURES},
        mean_steps=sum(steps) / len(steps) if steps else None,
        corrections=dict(sorted(corrections.items())),
    )


def _infrastructure_bounds(members: Sequence[Cell]) -> tuple[float, float] | None:
    """Return the success rate if all doubtful episodes had failed, and if all had succeeded.

    Doubtful are episodes that ended with an infrastructure error, and those that succeeded only after the policy's
    process had crashed. None if there are no doubtful episodes, or no episode defines success.
    """
    rates, doubtful = [], 0
    for cell in members:
        least, errors = sum(cell.certain), cell.failed(INFRASTRUCTURE)
        most, count = sum(cell.outcomes) + errors, len(cell.certain)
        doubtful += most - least
        if count:
            rates.append((least / count, most / count))
    if not doubtful or not rates:
        return None
    worst, best = (sum(ends) / len(rates) for ends in zip(*rates, strict=True))
    return worst, best


def _contrasts(cells: Sequence[Cell]) -> list[Contrast]:
    """Return by how much each setting's success rate exceeds the first one's, by task and over all tasks."""
    settings = list(dict.fromkeys(cell.setting for cell in cells))
    by_key = {(cell.task, cell.setting): cell for cell in cells}
    rows: list[Contrast] = []
    for other in settings[1:]:
        tasks = [task for task, setting in by_key if setting == settings[0] and (task, other) in by_key]
        parts = [(task, *_contrast(by_key[task, settings[0]], by_key[task, other])) for task in tasks]
        defined = [(estimate, pairs) for _, estimate, pairs in parts if estimate is not None]
        overall = (None, _mean(estimate for estimate, _ in defined), sum(pairs for _, pairs in defined))
        for task, estimate, pairs in [*parts, *([overall] if defined else [])]:
            difference, interval = (None, None) if estimate is None else estimate
            rows.append(Contrast(task, (settings[0], other), pairs, difference, interval))
    return rows


def _contrast(first: Cell, second: Cell) -> tuple[Estimate | None, int]:
    """Return second minus first, and by how many common seeds; without any, the two are taken as independent."""
    pairs = paired_counts(first.by_seed, second.by_seed)
    if pairs.total:
        return intervals.newcombe_paired(pairs), pairs.total
    one, other = first.success_rate("wilson"), second.success_rate("wilson")
    return (None if one is None or other is None else intervals.newcombe(one, other)), 0


def _mean(estimates: Iterable[Estimate | None]) -> Estimate | None:
    """Return the mean of those that are known, None if none is."""
    defined = [estimate for estimate in estimates if estimate is not None]
    return intervals.mean_estimate(defined) if defined else None


def _common_value(values: Iterable[_T]) -> _T | None:
    """Return what all values are, or None if they differ."""
    distinct = set(values)
    return distinct.pop() if len(distinct) == 1 else None
