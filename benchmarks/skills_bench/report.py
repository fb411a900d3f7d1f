"""Results of an evaluation as one document, and as a table for people."""

from __future__ import annotations

import platform
import statistics
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Final

from benchmarks.skills_bench.runs import RAN, Result
from xpl_cli import __version__
from xpl_cli.evaluation.statistics.intervals import wilson

SCHEMA: Final = "xpl.skill-evals/1"


def document(results: Sequence[Result]) -> dict[str, Any]:
    """Return all results, and their summary for each kind, skill, agent and condition."""
    return {
        "schema": SCHEMA,
        "xpl": __version__,
        "machine": {"system": platform.platform(), "python": platform.python_version()},
        "summary": [_summary(group) for group in _groups(results)],
        "runs": [asdict(result) for result in results],
    }


def table(summary: dict[str, Any]) -> str:
    """Return the summary, a line for each group."""
    head = (
        f"{'skill':<27}{'kind':<9}{'agent':<14}{'with':<8}{'passed':<10}{'95 %':<14}{'s':>7}{'rollout':>9}{'lines':>7}"
    )
    lines = [head]
    for row in summary["summary"]:
        passed = f"{row['passed']} of {row['ran']}" if row["ran"] else "not run"
        medians = [row["seconds"], row["first_rollout_s"], row["written_lines"]]
        texts = ["-" if value is None else f"{value:.0f}" for value in medians]
        interval = f"{row['interval'][0]:.0%} to {row['interval'][1]:.0%}" if row["interval"] else "-"
        lines.append(
            f"{row['skill']:<27}{row['kind']:<9}{row['agent'] or '-':<14}{row['condition']:<8}{passed:<10}"
            f"{interval:<14}{texts[0]:>7}{texts[1]:>9}{texts[2]:>7}"
        )
    reasons: dict[str, int] = {}
    for run in summary["runs"]:
        if run["status"] != RAN:
            reasons[run["reason"]] = reasons.get(run["reason"], 0) + 1
    return "\n".join(
        [*lines, *(f"not run: {count} of {len(summary['runs'])}: {reason}" for reason, count in reasons.items())]
    )


def _groups(results: Sequence[Result]) -> list[list[Result]]:
    groups: dict[tuple[str, str, str | None, str], list[Result]] = {}
    for result in results:
        groups.setdefault((result.kind, result.skill, result.agent, result.condition), []).append(result)
    return list(groups.values())


def _summary(group: Sequence[Result]) -> dict[str, Any]:
    ran = [result for result in group if result.status == RAN]
    passed = sum(bool(result.passed) for result in ran)
    first = group[0]
    return {
        "kind": first.kind,
        "skill": first.skill,
        "agent": first.agent,
        "condition": first.condition,
        "runs": len(group),
        "ran": len(ran),
        "passed": passed,
        "rate": passed / len(ran) if ran else None,
        "interval": list(wilson(passed / len(ran), len(ran))) if ran else None,
        "seconds": _median([result.seconds for result in ran]),
        "first_rollout_s": _median([result.first_rollout_s for result in ran]),
        "written_lines": _median([result.written_lines for result in ran]),
        "model_lines": _median([result.model_lines for result in ran]),
        "tokens": _tokens(ran),
    }


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median of what there is; None if there is nothing."""
    numbers = [value for value in values if value is not None]
    return statistics.median(numbers) if numbers else None


def _tokens(ran: Sequence[Result]) -> dict[str, int] | None:
    """Return the sums of what the agents counted, None if none did."""
    counted = [result.tokens for result in ran if result.tokens]
    names = sorted({name for tokens in counted for name in tokens})
    return {name: sum(tokens.get(name, 0) for tokens in counted) for name in names} or None
