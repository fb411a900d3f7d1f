"""Findings, verdicts and gates as Markdown."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import Context, Listed, notes, shortened, unproved
from xpl_cli.audit.formats.steps import next_commands
from xpl_cli.audit.rules.model import Finding, GateReport, Outcome, TargetReport, counted
from xpl_cli.audit.rules.verdict import Verdict, Word
from xpl_cli.basics.untrusted import in_markdown, one_line

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_MARKS = {
    Word.GREEN: "🟢",
    Word.PARTIAL: "🔵",
    Word.SHADOW: "🟡",
    Word.OPEN: "🟡",
    Word.INCOMPLETE: "🟣",
    Word.RED: "🔴",
}

_WORDS = {
    Outcome.PASS: "passed",
    Outcome.FAIL: "**failed**",
    Outcome.WARN: "warned",
    Outcome.NOT_APPLICABLE: "not applicable",
    Outcome.NOT_RUN: "**not run**",
    Outcome.ERROR: "**crashed**",
}


def besides(reports: Sequence[TargetReport], context: Context) -> list[str]:
    """Return what follows the findings: what was not proved, what was not real, what was measured, what to run next."""
    lines: list[str] = []
    open_ends = list(unproved(reports, context))
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
    measured = [(report.path, figure) for report in reports for gate in report.gates for figure in gate.figures]
    if measured:
        lines += ["", "### Measured", "", *(f"- {code(path)}, {in_markdown(str(figure))}" for path, figure in measured)]
    commands = next_commands(reports, context)
    if commands:
        lines += ["", "### Next", "", *(f"    {one_line(command)}" for command in commands)]
    return lines


def marked(verdict: Verdict) -> str:
    """Return a verdict with a colour."""
    return f"{_MARKS[verdict.word]} {in_markdown(str(verdict))}"


def ended(gate: GateReport) -> str:
    """Return how many rules of a gate ended how, or why it did not begin."""
    if gate.reason is not None:
        return in_markdown(gate.reason)
    counts = counted(gate.results)
    return ", ".join(f"{counts[outcome]} {_WORDS[outcome]}" for outcome in Outcome if counts[outcome])


def place(entry: Listed) -> str:
    """Return where a finding is."""
    line = "" if entry.finding.line is None else f":{entry.finding.line}"
    return code(f"{entry.path}{line}")


def told(finding: Finding) -> Iterator[str]:
    """Yield what a finding says: the message, then a list of what belongs to it."""
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
    """Return a text as a code span; its fence is longer than every run of backticks in it."""
    text = one_line(text)
    fence = "`" * (1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence} {text} {fence}" if text.strip("`") != text or not text else f"{fence}{text}{fence}"


def cell(text: str) -> str:
    """Return a text as a code span in a table, where a bar ends the cell wherever it stands."""
    return code(text) if "|" not in text else in_markdown(text)
