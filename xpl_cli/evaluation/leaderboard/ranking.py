"""The ranking of a field: `xpl.leaderboard/1` (spec/v1/leaderboard.schema.json)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.basics.errors import one_of
from xpl_cli.evaluation.records.cells import INFRASTRUCTURE
from xpl_cli.evaluation.statistics import cautions, intervals
from xpl_cli.evaluation.statistics.comparison import IncomparableError, compare
from xpl_cli.evaluation.statistics.summary import summarise

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl_cli.evaluation.leaderboard.field import Field
    from xpl_cli.evaluation.records.records import Run

SCHEMA = "xpl.leaderboard/1"
SUCCESS, SCORE = "success", "score"
ALPHA = 0.05


def rank(field: Field, by: str = SUCCESS) -> dict[str, Any]:
    """Return the ranking: by success rate, then by mean score, unless otherwise asked; equal ones share a rank.

    Args:
        field: the runs.
        by: `success`, `score`, or a dimension, by its success rate.

    Raises:
        UnknownNameError: no run has a task of such a dimension.
    """
    summaries = [summarise(run) for run in field.runs]
    known = [row["dimension"] for summary in summaries for row in summary["dimensions"]]
    one_of("--by", by, dict.fromkeys([SUCCESS, SCORE, *known]))
    order = sorted(range(len(summaries)), key=lambda place: _strength(summaries[place], by), reverse=True)
    best = field.runs[order[0]]
    rows, refusals = [], []
    for place in order:
        run, gap = field.runs[place], None
        try:
            gap = None if run is best else _gap(best, run)
        except IncomparableError as error:
            refusals.append(f"{run.folder} is not compared with the first: {error}.")
        rows.append(_row(run, summaries[place], gap))
    _number(rows, [_strength(summaries[place], by) for place in order])
    _correct(rows)
    result = {
        "schema": SCHEMA,
        "environment": summaries[0]["environment"],
        "confidence": summaries[0]["confidence"],
        "common": field.common,
        "tasks": list(dict.fromkeys(row["task"] for summary in summaries for row in summary["tasks"])),
        "settings": list(dict.fromkeys(row["setting"] for summary in summaries for row in summary["settings"])),
        "differences": [
            {"folder": str(field.runs[place].folder), **difference.as_json()} for place, difference in field.differences
        ],
        "rows": rows,
    }
    skipped = cautions.of_skipped([line for run in field.runs for line in run.skipped])
    asked = [] if by == SUCCESS else [f"Ranked by {by}; the comparison with the first is of success."]
    return {**result, "notes": [*asked, *skipped, *field.sentences(), *refusals, *_notes(result)]}


def labels(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what to call each row: its policy, with its folder where two have the same."""
    names = [row["policy"] for row in rows]
    return [
        f"{name} ({row['folder']})" if names.count(name) > 1 else name for name, row in zip(names, rows, strict=True)
    ]


def _strength(summary: Mapping[str, Any], by: str) -> tuple[float, float]:
    rows = [row for row in summary["dimensions"] if row["dimension"] == by]
    told = summary["overall"] if by in (SUCCESS, SCORE) else rows[0] if rows else {}
    rate, score = ((-1.0 if told.get(key) is None else told[key]) for key in ("success_rate", "mean_score"))
    return (score, rate) if by == SCORE else (rate, score)


def _row(run: Run, summary: Mapping[str, Any], gap: Mapping[str, Any] | None) -> dict[str, Any]:
    overall, policy = summary["overall"], run.plan.policy
    return {
        "folder": str(run.folder),
        "run": run.plan.run,
        "policy": policy.name,
        "checkpoint": policy.checkpoint and policy.checkpoint.digest,
        **{name: overall[name] for name in ("planned", "successes", "success_rate", "success_interval")},
        "judged": overall["judged"] + overall["failures"][INFRASTRUCTURE],  # which count as failed
        **{name: overall[name] for name in ("mean_score", "score_interval", "failures", "if_spoilt")},
        "settings": {row["setting"]: row["success_rate"] for row in summary["settings"]},
        "dimensions": {row["dimension"]: row["success_rate"] for row in summary["dimensions"]},
        "to_first": gap,
    }


def _gap(best: Run, run: Run) -> dict[str, Any]:
    """Return by how much a run differs from the best one on the episodes that both played."""
    overall = compare(best, run)["overall"]
    return {name: overall[name] for name in ("pairs", "difference", "interval", "p_value")}


def _number(rows: Sequence[dict[str, Any]], strengths: Sequence[tuple[float, float]]) -> None:
    """Give each row its rank: one more than the number of better ones."""
    for row, strength in zip(rows, strengths, strict=True):
        row["rank"] = 1 + strengths.index(strength)


def _correct(rows: Sequence[dict[str, Any]]) -> None:
    """Add to each comparison with the first its p-value, corrected for there being several."""
    gaps = [row["to_first"] for row in rows if row["to_first"] is not None]
    for gap, raised in zip(gaps, intervals.holm([gap["p_value"] for gap in gaps]), strict=True):
        gap["adjusted_p_value"] = raised


def _notes(result: Mapping[str, Any]) -> Iterator[str]:
    rows = result["rows"]
    names = labels(rows)
    if result["common"]:
        yield "Only episodes count that were played in every run; figures of the single runs differ from these."
    close = [
        name
        for name, row in zip(names, rows, strict=True)
        if row["to_first"] is not None and row["to_first"]["adjusted_p_value"] >= ALPHA
    ]
    if close:
        yield (
            f"Not told apart from {names[0]} by these episodes: {', '.join(close)}. Their order may be luck "
            "(exact McNemar test on equal seeds, corrected for the number of comparisons by Holm)."
        )
    if len(rows) > 1:
        yield "The best of several is partly the best by luck: its rate is likely to be lower in new episodes."
    spoilt = {
        name: row["failures"]["infrastructure"]
        for name, row in zip(names, rows, strict=True)
        if row["failures"]["infrastructure"]
    }
    if spoilt:
        told = ", ".join(f"{name} {count}" for name, count in spoilt.items())
        yield f"Episodes that the infrastructure spoilt count as failed, for nobody can tell who was to blame: {told}."
    yield cautions.scope()
