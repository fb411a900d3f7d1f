"""Caveats: sentences beside every table on what the data do not show."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.phrases import count_noun
from xpl_cli.evaluation.records import mock_settings
from xpl_cli.evaluation.records.cells import outcome
from xpl_cli.evaluation.records.failures import MAX_INFRASTRUCTURE_SHARE
from xpl_cli.evaluation.records.run_mode import INSTRUCTIONS
from xpl_cli.evaluation.runs.stopping import episodes_needed
from xpl_cli.evaluation.statistics.wording import interval, percent, were

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.evaluation.records.cells import Cell
    from xpl_cli.evaluation.statistics.summary_model import Summary, SummaryRow

_NARROW = 0.2
_MANY = 10


def of_instruction(instruction: str | None) -> list[str]:
    """Return the caveat for a policy that got one of `INSTRUCTIONS` instead of the task's instruction."""
    if instruction is None:
        return []
    return [f"The policy was {INSTRUCTIONS[instruction]}, so that this is no rate of the task."]


def of_summary(summary: Summary, cells: Sequence[Cell]) -> list[str]:
    """Return what a reader of a summary should know before believing it."""
    overall = summary.overall
    unreal = mock_settings.remark(summary.environment, (cell.setting for cell in cells))
    return [
        *([] if unreal is None else [unreal]),
        *_missing_episodes(overall, cells),
        *_stopping_notes(summary.until_width, cells),
        *_width_notes(summary.cells),
        *_mean_notes(summary.cells),
        *_seed_notes(cells),
        scope(),
    ]


def of_execution(beyond: int, machines: int, recovered: int) -> list[str]:
    """Return caveats about the execution of a run, which may differ if the same run is repeated.

    Args:
        beyond: number of episodes that ran although their cell had ended.
        machines: number of machines, or sets of library versions.
        recovered: number of episodes that succeeded after an attempt with an infrastructure error.
    """
    notes = []
    if recovered:
        notes.append(
            f"{count_noun(recovered, 'episode')} succeeded after an attempt that ended with an infrastructure error: "
            "many of these may mean that a policy breaks attempts that it is about to fail."
        )
    if beyond:
        notes.append(
            f"{count_noun(beyond, 'episode')} ran beside the one that ended a task and do not count, so that the "
            "result does not depend on the number of workers."
        )
    if machines > 1:
        notes.append(
            f"Episodes ran on {machines} machines or sets of library versions, which may give different results for "
            "equal seeds."
        )
    return notes


def of_skipped(lines: Sequence[str]) -> list[str]:
    """Return what should be known of a run of which lines were left out because they are bad."""
    if not lines:
        return []
    return [f"{were(len(lines), 'line')} left out of the record: {'; '.join(lines[:3])}."]


def scope() -> str:
    """Return what intervals are about at all."""
    return (
        "The intervals cover the sampling of episodes: how far the rates of many more episodes with the same "
        "checkpoint, tasks, settings, environment and robot may lie from these. They do not cover other tasks, another "
        "training run of the same method, or a real robot."
    )


def of_stopping() -> str:
    """Return what it costs to stop when an interval is narrow enough."""
    return (
        "Tasks ended as soon as their interval was narrow enough. Such intervals hold the true rate in 95 % of the "
        "cases on average over all rates, but in as few as 92 % at some."
    )


def _missing_episodes(overall: SummaryRow, cells: Sequence[Cell]) -> Iterator[str]:
    if overall.remaining:
        yield (
            f"{count_noun(overall.remaining, 'episode')} of {overall.planned} still to be run: the rows cover the "
            "others."
        )
    yield from _infrastructure_errors(overall, cells)
    undefined = [f"{cell.task} ({cell.setting})" for cell in cells if cell.counted and not cell.outcomes]
    if undefined:
        yield f"No episode defines success in {', '.join(undefined)}; rows over several tasks leave these out."


def _infrastructure_errors(overall: SummaryRow, cells: Sequence[Cell]) -> Iterator[str]:
    errors = overall.failures[INFRASTRUCTURE]
    after_crash = sum(cell.counts_as_success(line) is False for cell in cells for line in cell.counted if outcome(line))
    if errors and overall.judged:
        rate = percent(overall.successes / overall.judged)
        yield (
            f"{count_noun(errors, 'episode')} ended with an infrastructure error and count as failed, because the "
            f"cause cannot be attributed: without them {overall.successes} of {overall.judged} succeeded ({rate})."
        )
    elif errors:
        yield f"{count_noun(errors, 'episode')} ended with an infrastructure error: they have no result."
    if after_crash:
        yield (
            f"{count_noun(after_crash, 'episode')} succeeded only after the policy's process had crashed in an earlier "
            "attempt, and count as failed."
        )
    if overall.infrastructure_bounds:
        worst, best = map(percent, overall.infrastructure_bounds)
        yield f"The overall rate is {worst} with these as failures; it would be {best} had all of them succeeded."
    if (share := errors / max(1, overall.completed)) > MAX_INFRASTRUCTURE_SHARE:
        yield (
            f"{percent(share)} of the episodes ended with an infrastructure error, more than "
            f"{percent(MAX_INFRASTRUCTURE_SHARE)}: the run is not ranked."
        )


def _stopping_notes(width: float | None, cells: Sequence[Cell]) -> Iterator[str]:
    if width is None:
        return
    yield of_stopping()
    short = [f"{cell.task} ({cell.setting})" for cell in cells if not cell.ended and not cell.remaining]
    if short:
        yield f"No seeds are left, and the interval is still wider than requested: {', '.join(short)}."


def _width_notes(rows: Sequence[SummaryRow]) -> Iterator[str]:
    intervals = [(row.success_interval, row) for row in rows if row.success_interval is not None]
    if not intervals:
        return
    (low, high), widest = max(intervals, key=lambda one: one[0].width)
    if high - low > _NARROW:
        needed = episodes_needed(_NARROW, rate=min(max(0.5, low), high))
        yield (
            f"With {count_noun(widest.judged, 'episode')}, the rate of {widest.task} ({widest.setting}) is known no "
            f"better than {interval(low, high)}; an interval of {_NARROW * 100:.0f} points takes up to {needed}."
        )


def _mean_notes(rows: Sequence[SummaryRow]) -> Iterator[str]:
    judged_rows = [row for row in rows if row.judged]
    if len({row.judged for row in judged_rows}) > 1:
        yield (
            "Not all rows have equally many episodes. Rows over several tasks or settings are means of the rates, in "
            "which each weighs the same, and not the share of all successes."
        )
    if len(judged_rows) >= _MANY:
        yield (
            f"Of {len(judged_rows)} intervals with 95 % confidence, {len(judged_rows) * 0.05:.1f} miss the rate on "
            "average; the best and the worst row are extreme partly by chance."
        )


def _seed_notes(cells: Sequence[Cell]) -> Iterator[str]:
    if not all(cell.frozen for cell in cells):
        yield (
            "Not all seeds are the environment's evaluation seeds: the policy may have been trained or tuned on them."
        )
