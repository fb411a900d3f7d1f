"""Texts and charts of the page, made from a summary and the run."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from xpl_cli import __version__
from xpl_cli.evaluation.records import mock_settings, run_mode
from xpl_cli.evaluation.report import figures, latency, provenance
from xpl_cli.evaluation.report.number_format import between, duration, many, milliseconds, points
from xpl_cli.evaluation.report.page_model import (
    Bar,
    ChartGroup,
    ChartRow,
    Contrasts,
    CorrectionCount,
    EndingCount,
    Failures,
    HeadFigure,
    Headline,
    LabelledClass,
    PageTable,
    PageView,
    Reason,
    TableCell,
    TableRow,
    TaskBars,
)
from xpl_cli.evaluation.statistics import wording

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.statistics.summary_model import ExecutionStats, Summary, SummaryRow

_COLOURS = 5  # of settings, in page.css
_MOST_REASONS = 8


def view(run: Run, summary: Summary, media_said: str) -> PageView:
    """Return the content of the page.

    Args:
        run: the run.
        summary: of it.
        media_said: a sentence on videos and curves.
    """
    overall = summary.overall
    complete = not overall.remaining
    kinds = _kinds(summary)
    return PageView(
        title=f"{summary.policy} in {summary.environment}",
        policy=summary.policy,
        environment=summary.environment,
        complete=complete,
        state="complete" if complete else f"{overall.completed} of {overall.planned} episodes",
        about=_about(summary, run_mode.run_mode_of(run.plan).description),
        headline=_headline(summary),
        facts=_facts(summary),
        confidence=wording.percent(summary.confidence),
        settings=[LabelledClass(name, kind) for name, kind in kinds.items()],
        tasks=_tasks(summary, kinds),
        groups=_groups(summary, kinds),
        contrasts=_contrasts(summary, kinds),
        table=_table(summary, kinds),
        notes=[*summary.notes, *summary.execution.notes],
        failures=_failures(run, overall),
        corrections=_corrections(run, overall),
        latency=latency.view(summary.execution.inference),
        media_said=media_said,
        versions=provenance.view(run, summary),
        footer=f"Made by xpl {__version__} from the record of this run.",
    )


def _kinds(summary: Summary) -> dict[str, str]:
    """Return the colour class of each setting."""
    settings = filter(None, (row.setting for row in summary.cells))
    return {name: f"s{index % _COLOURS}" for index, name in enumerate(dict.fromkeys(settings))}


def _about(summary: Summary, unusual: str) -> str:
    tasks, settings = len(summary.tasks), len(summary.settings)
    robot = f"{summary.embodiment}, {summary.action_type} control"
    planned = f"{many(summary.overall.planned, 'episode')} planned"
    unreal = mock_settings.remark(summary.environment, filter(None, (row.setting for row in summary.settings)))
    mode = f", {unusual}" if unusual else ""
    summary_text = f"{robot}. {many(tasks, 'task')} in {many(settings, 'setting')}, {planned}{mode}."
    return summary_text if unreal is None else f"{unreal} {summary_text}"


def _headline(summary: Summary) -> Headline:
    overall = summary.overall
    rate, interval = overall.success_rate, overall.success_interval
    if rate is None or interval is None:
        caption = "No episode defines success yet."
        return Headline(wording.NOTHING, "", caption, figures.strip(None, None, "s0", caption))
    low, high = interval
    caption = (
        f"{overall.successes} of {overall.judged} episodes succeeded. "
        f"The {wording.percent(summary.confidence)} interval goes from {100 * low:.1f} to {100 * high:.1f} %."
    )
    figure = figures.strip(rate, interval, "s0", f"{100 * rate:.1f} % {caption}")
    return Headline(f"{100 * rate:.1f}".removesuffix(".0"), "%", caption, figure)


def _facts(summary: Summary) -> list[HeadFigure]:
    overall, execution = summary.overall, summary.execution
    failures, score, inference = overall.failures, overall.mean_score, execution.inference
    known_score = wording.NOTHING if score is None else f"{score:.2f}"
    return [
        HeadFigure("Mean score", known_score, between(overall.score_interval, 2)),
        HeadFigure("Task not achieved", str(failures["task"]), "ran to the end"),
        HeadFigure("Failed by the policy", str(failures["policy"]), "error or stopped; no success"),
        HeadFigure("Infrastructure errors", str(failures["infrastructure"]), _bounds(overall, execution)),
        HeadFigure("Action request", milliseconds(inference.p50), f"median; 95 % within {milliseconds(inference.p95)}"),
        HeadFigure(
            "Run time",
            duration(execution.wall_seconds),
            f"all episodes together, {many(execution.attempts, 'attempt')}",
        ),
    ]


def _bounds(overall: SummaryRow, execution: ExecutionStats) -> str:
    bounds = overall.infrastructure_bounds
    retried = f"{execution.retried} run again" if execution.retried else ""
    if bounds is None:
        return retried or "nothing left out"
    return f"left out; {100 * bounds[0]:.1f} to {100 * bounds[1]:.1f} % if counted"


def _tasks(summary: Summary, kinds: Mapping[str, str]) -> list[TaskBars]:
    tasks: dict[str, TaskBars] = {}
    for row in summary.cells:
        task, setting = str(row.task), str(row.setting)
        label = f"{task}, {setting}: {wording.rate(row)}"
        figure = figures.bar(row.success_rate, row.success_interval, kinds[setting], label)
        tasks.setdefault(task, TaskBars(task, row.dimension, [])).bars.append(Bar(figure, wording.rate(row)))
    return list(tasks.values())


def _groups(summary: Summary, kinds: Mapping[str, str]) -> list[ChartGroup]:
    """Return the rows by setting and by dimension, where there are several."""
    groups = []
    for title, rows in (
        ("By setting", [(str(row.setting), row) for row in summary.settings]),
        ("By dimension", [(str(row.dimension), row) for row in summary.dimensions]),
    ):
        if len(rows) > 1:
            groups.append(ChartGroup(title, [_line(name, row, kinds.get(name, "s0")) for name, row in rows]))
    return groups


def _line(name: str, row: SummaryRow, kind: str) -> ChartRow:
    text = wording.rate(row)
    return ChartRow(name, text, figures.strip(row.success_rate, row.success_interval, kind, f"{name}: {text}"))


def _contrasts(summary: Summary, kinds: Mapping[str, str]) -> Contrasts:
    rows = [row for row in summary.contrasts if row.difference is not None]
    if not rows:
        return Contrasts([])
    first = rows[0].settings[0]
    others = list(dict.fromkeys(row.settings[1] for row in rows))
    named = f" in {others[0]}" if len(others) == 1 else ""
    shared = {bool(row.pairs) for row in rows}
    how = "on seeds of their own where the two share none"
    if len(shared) == 1:
        how = "on the same seeds" if shared.pop() else "on seeds of their own"
    lines = []
    for row in rows:
        task, other = row.task or "all tasks", row.settings[1]
        name = task if named else f"{task}, {other}"
        low, high = map(points, row.interval or ())
        text = f"{points(row.difference or 0.0)} ({low} to {high})"
        figure = figures.difference(row.difference, row.interval, kinds[other], f"{name}: {text}")
        lines.append(ChartRow(name, text, figure))
    return Contrasts(
        lines,
        f"{first.capitalize()} against {others[0] if named else 'the others'}",
        f"Success rate{named} minus that in {first}, in points, {how}. An interval with 0 shows no difference.",
    )


def _table(summary: Summary, kinds: Mapping[str, str]) -> PageTable:
    header = [
        LabelledClass("Task", ""),
        LabelledClass("Setting", ""),
        LabelledClass("Episodes", "number"),
        LabelledClass("Success", "number"),
        LabelledClass("", "mini"),
        LabelledClass("Interval", "number"),
        LabelledClass("Score", "number"),
        LabelledClass("Interval", "number"),
        LabelledClass("Policy", "number"),
        LabelledClass("Infrastructure", "number"),
        LabelledClass("Steps", "number"),
    ]
    rows = []
    for row in wording.table_rows(summary):
        texts = _cells(row, kinds.get(row.setting or "", "s0"))
        cells = [TableCell(value, column.kind) for value, column in zip(texts, header, strict=True)]
        rows.append(TableRow(row.task is None, cells))
    return PageTable(header, rows)


def _cells(row: SummaryRow, kind: str) -> Sequence[str]:
    rate, score, failures = row.success_rate, row.mean_score, row.failures
    episodes = str(row.judged) if not row.remaining else f"{row.judged} of {row.planned}"
    return (
        row.task or "all tasks",
        row.setting or "all",
        episodes,
        wording.NOTHING if rate is None else f"{100 * rate:.1f} %",
        figures.strip(rate, row.success_interval, kind, wording.rate(row)),
        between(row.success_interval, 1, 100),
        wording.NOTHING if score is None else f"{score:.2f}",
        between(row.score_interval, 2),
        str(failures["policy"]),
        str(failures["infrastructure"]),
        wording.NOTHING if row.mean_steps is None else f"{row.mean_steps:.0f}",
    )


def _failures(run: Run, overall: SummaryRow) -> Failures:
    failures = overall.failures
    counts = {
        "success": overall.successes,
        "task": failures["task"],
        "policy": failures["policy"],
        "infrastructure": failures["infrastructure"],
        "not-judged": overall.completed - overall.judged - failures["infrastructure"],
        "remaining": overall.remaining,
    }
    names = {
        "success": "succeeded",
        "task": "task not achieved",
        "policy": "failed by the policy",
        "infrastructure": "infrastructure error",
        "not-judged": "nothing to succeed at",
        "remaining": "not run yet",
    }
    reasons = Counter(
        episode.error or episode.end_reason or "no reason"
        for episode in run.finals.values()
        if episode.failure is not None
    )
    return Failures(
        said=(
            "Of all planned episodes. An episode that the policy breaks or a guard stops has failed; one with an "
            "infrastructure error is retried a limited number of times and then counts as failed."
        ),
        figure=figures.shares(counts, ", ".join(f"{names[kind]} {count}" for kind, count in counts.items())),
        parts=[EndingCount(kind, names[kind], count) for kind, count in counts.items() if count],
        reasons=[Reason(text, count) for text, count in reasons.most_common(_MOST_REASONS)],
    )


def _corrections(run: Run, overall: SummaryRow) -> list[CorrectionCount]:
    touched = Counter(kind for episode in run.finals.values() for kind in episode.corrections or {})
    return [
        CorrectionCount(kind.replace("_", " "), f"{many(steps, 'step')} of {many(touched[kind], 'episode')}")
        for kind, steps in sorted(overall.corrections.items(), key=lambda item: -item[1])
    ]
