"""`text`: a report for people; passes collapsed, the next command last.

On a terminal it fits on one screen. In a file every finding is listed, on one line each if they would not fit.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import (
    ListedFinding,
    ReportContext,
    by_reason,
    join_path,
    listed_findings,
    shortened,
)
from xpl_cli.audit.formats.next_steps import audit_again, next_commands
from xpl_cli.audit.formats.styled_text import OutputStyle, StyledText
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport, count_outcomes
from xpl_cli.audit.rules.verdict import Verdict, VerdictStatus, verdict_of
from xpl_cli.basics.phrases import count_noun
from xpl_cli.basics.untrusted import one_line

if TYPE_CHECKING:
    from collections.abc import Sequence

_SCREEN = 29
"""Lines of a screen for findings; head, verdict and next commands take the rest."""

_LEAST = 4
"""Least number of lines for the findings of one of many targets."""

_LEAST_TOLD = 40
"""Least number of characters of a message."""

_INDENT = 8
"""Columns at both ends of a wrapped line that may stay empty."""

_WIDTH = 100
_MOST_VALUE = 200
"""Characters of what was expected and what came: a whole error, and no array."""
_COLOURS = {
    Outcome.PASS: "green",
    Outcome.WARN: "yellow",
    Outcome.FAIL: "red",
    Outcome.ERROR: "red",
    Outcome.NOT_RUN: "magenta",
    Outcome.NOT_APPLICABLE: "dim",
}
_MARKS = {
    Outcome.PASS: "ok",
    Outcome.WARN: "warn",
    Outcome.FAIL: "FAIL",
    Outcome.ERROR: "ERROR",
    Outcome.NOT_RUN: "not run",
    Outcome.NOT_APPLICABLE: "n/a",
}
_VERDICTS = {
    VerdictStatus.GREEN: "bold green",
    VerdictStatus.PARTIAL: "bold cyan",
    VerdictStatus.SHADOW: "bold yellow",
    VerdictStatus.OPEN: "bold yellow",
    VerdictStatus.INCOMPLETE: "bold magenta",
    VerdictStatus.RED: "bold red",
}


@dataclass(frozen=True)
class _Space:
    """Space for the findings of one target.

    Attributes:
        lines, width: of the screen.
        is_file: whether the output is a file, so that nothing is left out or shortened.
    """

    lines: int
    width: int
    is_file: bool


def render(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the report without colours, for a file."""
    return on_terminal(reports, context, OutputStyle())


def on_terminal(reports: Sequence[TargetReport], context: ReportContext, terminal: OutputStyle) -> str:
    """Return the report for a terminal."""
    width = min(terminal.width or _WIDTH, _WIDTH)
    by_target: dict[int, list[ListedFinding]] = {}
    for entry in listed_findings(reports, context):
        by_target.setdefault(id(entry.target), []).append(entry)
    room = _Space(max(_LEAST, _SCREEN // max(1, len(by_target))), width, is_file=terminal.width is None)
    parts: list[StyledText] = []
    for report in reports:
        again = audit_again([report], context)
        parts += _target(report, by_target.get(id(report), []), room, again, alone=len(reports) == 1)
    if len(reports) > 1:
        verdicts = Counter(verdict_of(report).status for report in reports)
        counts = ", ".join(f"{verdicts[word]} {word}" for word in reversed(VerdictStatus) if verdicts[word])
        parts.append(StyledText.of((f"{len(reports)} targets: {counts}", "bold")))
    commands = next_commands(reports, context)
    if commands:
        parts.append(StyledText.of(("next", "dim")))
        parts += [StyledText(wraps=False).append(f"  {one_line(command)}") for command in commands]
    return "".join(f"{part.render(terminal)}\n" for part in parts)


def _target(
    report: TargetReport, entries: list[ListedFinding], room: _Space, again: str, *, alone: bool
) -> list[StyledText]:
    """Return the part of one target: short if it is one of several, one line if it then has no findings."""
    name, path = one_line(report.name), one_line(report.path)
    verdict = verdict_of(report)
    head = StyledText.of((name, "bold"), (f"  {path}", "dim"))
    if not alone:
        head = StyledText.of((name, "bold"), (f"  {path}  ", "dim"), *_verdict(verdict))
        if not entries and verdict.status not in (VerdictStatus.RED, VerdictStatus.INCOMPLETE):
            return [head]
    lines = [head]
    fitting = _fit_findings(entries, room)
    for gate in report.gates:
        lines += [_gate(gate), *(block for entry, block in fitting if entry.gate is gate), *_unproved(gate)]
        lines += [StyledText.of("  ", one_line(str(figure))) for figure in gate.measurements]
        lines += _waived(gate)
        if alone and gate.finish is not None:
            lines.append(StyledText.of((f"  {gate.finish}", "dim")))
    if len(fitting) < len(entries):
        more = count_noun(len(entries) - len(fitting), "finding")
        lines.append(StyledText.of(f"  {more} more: `{one_line(again)} --output audit.txt` lists all"))
    return [*lines, StyledText.of(("verdict  ", "dim"), *_verdict(verdict)) if alone else StyledText()]


def _verdict(verdict: Verdict) -> tuple[tuple[str, str], str]:
    """Return the text of a verdict, its status in colour."""
    word, said = verdict.status.upper(), one_line(str(verdict))
    return (word, _VERDICTS[verdict.status]), said.removeprefix(word)


def _gate(gate: GateReport) -> StyledText:
    """Return the line of a gate: its outcome, and the number of rules of each outcome."""
    head = StyledText.of((f"{gate.name:<8} ", "bold"), (f"{_MARKS[gate.outcome]:<8}", _COLOURS[gate.outcome]))
    if gate.reason is not None:
        return head.append(one_line(gate.reason))
    counts = count_outcomes(gate.results)
    waived = sum(len(result.waived) for result in gate.results)
    parts = [f"{counts[outcome]} {_MARKS[outcome]}" for outcome in Outcome if counts[outcome]]
    head.append(", ".join([*parts, *([f"{waived} waived"] if waived else [])]))
    return head.append(f"  {gate.seconds:.1f} s", "dim")


def _unproved(gate: GateReport) -> list[StyledText]:
    """Return a line for each reason with the rules that could not run for it."""
    if gate.reason is not None:  # it is in the line of the gate
        return []
    outcomes = {Outcome.ERROR, Outcome.NOT_RUN} | ({gate.outcome} & {Outcome.NOT_APPLICABLE})
    lines = [] if gate.stood_in is None else [StyledText.of("  ", (one_line(gate.stood_in), _COLOURS[Outcome.WARN]))]
    for (outcome, reason), (first, *others) in by_reason(gate, outcomes).items():
        who = f"{first.code} {first.slug}" + (f" and {len(others)} more" if others else "")
        lines.append(StyledText.of("  ", (who, _COLOURS[outcome]), f": {_MARKS[outcome]}: {one_line(reason)}"))
    return lines


def _waived(gate: GateReport) -> list[StyledText]:
    """Return a line for each rule and reason of waived findings."""
    counts = Counter((result.code, result.slug, item.reason) for result in gate.results for item in result.waived)
    lines = []
    for (code, slug, reason), count in counts.items():
        times = "" if count == 1 else f" ({count} times)"
        lines.append(StyledText.of("  ", (f"{code} {slug}", "dim"), f": waived{times}: {shortened(one_line(reason))}"))
    return lines


def _fit_findings(entries: list[ListedFinding], room: _Space) -> list[tuple[ListedFinding, StyledText]]:
    """Return as many findings as fit, failures first, with as many details as fit; in a file all findings."""
    entries = sorted(entries, key=lambda entry: not entry.fails)
    for failure, warning in _LAYOUTS:
        blocks = [(entry, (failure if entry.fails else warning)(entry, room)) for entry in entries]
        ends = list(itertools.accumulate(block.height(room.width) for _, block in blocks))
        if not ends or ends[-1] <= room.lines:
            break
    return blocks if room.is_file else blocks[: max(1, sum(end <= room.lines for end in ends))]


def _with_evidence(entry: ListedFinding, room: _Space) -> StyledText:
    """Return a finding with its message, expected, got, evidence and fix."""
    finding = entry.finding
    pairs = (("expected", finding.expected), ("got", finding.got))
    values = ", ".join(f"{name} {shortened(one_line(value), _MOST_VALUE)}" for name, value in pairs if value)
    text = _with_message(entry, room)
    if values:
        text.append(f"\n    {values}", "dim")
    for name, value in (finding.evidence or {}).items():
        text.append(f"\n    {one_line(name)}: {shortened(one_line(str(value)))}", "dim")
    return text.append(_fix(entry))


def _with_fix(entry: ListedFinding, room: _Space) -> StyledText:
    """Return a finding with its message and its fix."""
    return _with_message(entry, room).append(_fix(entry))


def _with_message(entry: ListedFinding, _room: _Space) -> StyledText:
    """Return a finding with its message."""
    return _head(entry).append(f"\n    {one_line(entry.finding.message)}")


def _on_one_line(entry: ListedFinding, room: _Space) -> StyledText:
    """Return a finding on one line, or on two if its path alone fills one."""
    head, message = _head(entry), one_line(entry.finding.message)
    if room.is_file:
        return head.append(f"  {message}")
    free = room.width - len(head.plain) - 2
    most = free if free >= _LEAST_TOLD else free + room.width - _INDENT
    return head.append(f"  {shortened(message, max(_LEAST_TOLD, most))}")


def _head(entry: ListedFinding) -> StyledText:
    finding = entry.finding
    text = StyledText.of("  ", (entry.title, f"bold {_COLOURS[entry.result.outcome]}"))
    if finding.path is not None:
        line = "" if finding.line is None else f":{finding.line}"
        text.append(f"  {one_line(join_path(entry.target.path, finding.path))}{line}")
    return text


def _fix(entry: ListedFinding) -> str:
    fix = entry.finding.fix
    return "" if fix is None else f"\n    fix: {one_line(fix.text)}"


_LAYOUTS = (
    (_with_evidence, _with_evidence),
    (_with_fix, _with_fix),
    (_with_fix, _with_message),
    (_with_message, _with_message),
    (_with_message, _on_one_line),
    (_on_one_line, _on_one_line),
)
"""Layouts of failures and warnings, from most to least detailed."""
