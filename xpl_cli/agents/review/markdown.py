"""Findings, verdicts and gates as Markdown."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import ListedFinding, ReportContext, notes, shortened, unproven_rules
from xpl_cli.audit.formats.next_steps import next_commands
from xpl_cli.audit.rules.model import Finding, GateReport, Outcome, TargetReport, count_outcomes
from xpl_cli.audit.rules.verdict import Verdict, VerdictStatus
from xpl_cli.basics.untrusted import in_markdown, one_line

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_MARKS = {
    VerdictStatus.GREEN: "🟢",
    VerdictStatus.PARTIAL: "🔵",
    VerdictStatus.SHADOW: "🟡",
    VerdictStatus.OPEN: "🟡",
    VerdictStatus.INCOMPLETE: "🟣",
    VerdictStatus.RED: "🔴",
}

_WORDS = {
    Outcome.PASS: "passed",
    Outcome.FAIL: "**failed**",
    Outcome.WARN: "warned",
    Outcome.NOT_APPLICABLE: "not applicable",
    Outcome.NOT_RUN: "**not run**",
    Outcome.ERROR: "**crashed**",
}


def closing_sections(reports: Sequence[TargetReport], context: ReportContext) -> list[str]:
    """Return the sections after the findings: unproven rules, shadow runs, measurements, next commands."""
    lines: list[str] = []
    open_ends = list(unproven_rules(reports, context))
    if open_ends:
        lines += ["", "### Not proved", ""]
        lines += [f"- {code(item.path)}, {item.gate.name} gate: {in_markdown(item.text)}" for item in open_ends]
    missing = list(notes(reports, context))
    if missing:
        lines += [
            "",
            "### Without the model",
            "",
            *(f"- {code(path)}, {in_markdown(note)}" for path, _, note in missing),
        ]
    measured = [(report.path, figure) for report in reports for gate in report.gates for figure in gate.measurements]
    if measured:
        lines += ["", "### Measured", "", *(f"- {code(path)}, {in_markdown(str(figure))}" for path, figure in measured)]
    commands = next_commands(reports, context)
    if commands:
        lines += ["", "### Next", "", *(f"    {one_line(command)}" for command in commands)]
    return lines


def verdict_with_icon(verdict: Verdict) -> str:
    """Return a verdict with its colour icon."""
    return f"{_MARKS[verdict.status]} {in_markdown(str(verdict))}"


def gate_summary(gate: GateReport) -> str:
    """Return the number of rules of a gate by outcome, or why the gate did not run."""
    if gate.reason is not None:
        return in_markdown(gate.reason)
    counts = count_outcomes(gate.results)
    return ", ".join(f"{counts[outcome]} {_WORDS[outcome]}" for outcome in Outcome if counts[outcome])


def location(entry: ListedFinding) -> str:
    """Return path and line of a finding."""
    line = "" if entry.finding.line is None else f":{entry.finding.line}"
    return code(f"{entry.path}{line}")


def finding_lines(finding: Finding) -> Iterator[str]:
    """Yield the message of a finding, then a list of its details."""
    yield in_markdown(finding.message)
    if finding.expected is not None:
        yield f"- expected {in_markdown(finding.expected)}"
    if finding.got is not None:
        yield f"- got {code(shortened(one_line(finding.got)))}"
    for name, value in (finding.evidence or {}).items():
        yield f"- {in_markdown(name)}: {code(shortened(one_line(str(value))))}"
    if finding.fix is not None:
        fix = code(finding.fix.text) if finding.fix.kind == "command" else in_markdown(finding.fix.text)
        yield f"- fix: {fix}"


def code(text: str) -> str:
    """Return a text as a code span; its fence is longer than any run of backticks in it."""
    text = one_line(text)
    fence = "`" * (1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence} {text} {fence}" if text.strip("`") != text or not text else f"{fence}{text}{fence}"


def cell(text: str) -> str:
    """Return a text as a code span for a table cell, escaped if it has a `|`."""
    return code(text) if "|" not in text else in_markdown(text)
