"""`human`: what a person at a terminal wants to know, on one screen; passes collapsed, the next command last."""

from __future__ import annotations

import io
import itertools
import math
from collections import Counter
from typing import TYPE_CHECKING, Any

from xpl_cli.audit.formats.listing import (
    Context,
    Listed,
    amount,
    by_reason,
    joined,
    listed,
    one_line,
    shortened,
)
from xpl_cli.audit.formats.steps import next_commands
from xpl_cli.audit.model import GateReport, Outcome, TargetReport, counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.text import Text

_SCREEN = 29
"""Lines of a screen that findings may take; head, verdict and next commands take the rest."""

_LEAST = 4
"""Lines for the findings of one of many targets."""

_WIDTH = 100
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
_VERDICTS = {"green": "bold green", "red": "bold red", "incomplete": "bold magenta"}


def render(reports: Sequence[TargetReport], context: Context) -> str:
    """Return the report without colours, for a file."""
    from rich.console import Console

    stream = io.StringIO()
    Console(file=stream, width=_WIDTH, color_system=None, highlight=False, soft_wrap=True).print(
        as_text(reports, context)
    )
    return stream.getvalue()


def as_text(reports: Sequence[TargetReport], context: Context) -> Any:
    """Return the report as a rich renderable."""
    from rich.console import Group
    from rich.text import Text

    found: dict[int, list[Listed]] = {}
    for entry in listed(reports, context):
        found.setdefault(id(entry.target), []).append(entry)
    room = max(_LEAST, _SCREEN // max(1, len(found)))
    parts: list[Text] = []
    for report in reports:
        parts += _target(report, found.get(id(report), []), room, alone=len(reports) == 1)
    if len(reports) > 1:
        verdicts = Counter(report.verdict for report in reports)
        told = ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items()))
        parts += [Text(f"{len(reports)} targets: {told}", style="bold")]
    commands = next_commands(reports)
    if commands:
        parts += [Text("next", style="dim"), *(Text(f"  {one_line(command)}") for command in commands)]
    return Group(*parts)


def _target(report: TargetReport, entries: list[Listed], room: int, *, alone: bool) -> list[Text]:
    """Return the part of one target: short if it is one of several, one line if besides all is well."""
    from rich.text import Text

    name, path = one_line(report.name), one_line(report.path)
    verdict = (report.verdict.upper(), _VERDICTS[report.verdict])
    head = Text.assemble((name, "bold"), (f"  {path}", "dim"))
    if not alone:
        head.append("  ").append(*verdict)
        if report.verdict == "green" and not entries:
            return [head.append(f"  {', '.join(gate.name for gate in report.gates)}")]
    lines = [head]
    shown = _fitting(entries, room)
    for gate in report.gates:
        lines += _gate(gate)
        lines += [block for entry, block in shown if entry.gate is gate]
        lines += _unproved(gate)
        if alone and gate.finish is not None:
            lines.append(Text(f"  {gate.finish}", style="dim"))
    if len(shown) < len(entries):
        more = amount(len(entries) - len(shown), "finding")
        lines.append(Text(f"  {more} more: `xpl audit {path} --format concise` lists all"))
    return [*lines, Text.assemble(("verdict  ", "dim"), verdict) if alone else Text("")]


def _gate(gate: GateReport) -> list[Text]:
    """Return the line of a gate: how it ended, and how many rules ended how."""
    from rich.text import Text

    head = Text.assemble((f"{gate.name:<8} ", "bold"), (f"{_MARKS[gate.outcome]:<8}", _COLOURS[gate.outcome]))
    if gate.reason is not None:
        return [head.append(one_line(gate.reason))]
    counts = counted(gate.results)
    waived = sum(len(result.waived) for result in gate.results)
    told = [f"{counts[outcome]} {_MARKS[outcome]}" for outcome in Outcome if counts[outcome]]
    head.append(", ".join([*told, *([f"{waived} waived"] if waived else [])]))
    return [head.append(f"  {gate.seconds:.1f} s", style="dim")]


def _unproved(gate: GateReport) -> list[Text]:
    """Say once for each reason which rules could not prove anything for it."""
    from rich.text import Text

    if gate.reason is not None:  # the line of the gate says it
        return []
    outcomes = {Outcome.ERROR, Outcome.NOT_RUN} | ({gate.outcome} & {Outcome.NOT_APPLICABLE})
    lines = []
    for (outcome, reason), (first, *others) in by_reason(gate, outcomes).items():
        who = f"{first.code} {first.slug}" + (f" and {len(others)} more" if others else "")
        lines.append(Text.assemble("  ", (who, _COLOURS[outcome]), f": {_MARKS[outcome]}: {one_line(reason)}"))
    return lines


def _fitting(entries: list[Listed], room: int) -> list[tuple[Listed, Text]]:
    """Return as many findings as fit, failures first, in as much detail as lets all of them fit."""
    entries = sorted(entries, key=lambda entry: not entry.fails)
    for shape in (_full, _advised, _told, _short):
        blocks = [(entry, shape(entry)) for entry in entries]
        ends = list(itertools.accumulate(_height(block) for _, block in blocks))
        if not ends or ends[-1] <= room:
            break
    return blocks[: max(1, sum(end <= room for end in ends))]


def _height(block: Text) -> int:
    return sum(max(1, math.ceil(len(line) / _WIDTH)) for line in block.plain.split("\n"))


def _full(entry: Listed) -> Text:
    """Return a finding with its message, what was expected, what came, evidence and fix."""
    finding = entry.finding
    pairs = (("expected", finding.expected), ("got", finding.got))
    values = ", ".join(f"{name} {shortened(one_line(value), 80)}" for name, value in pairs if value)
    text = _told(entry)
    if values:
        text.append(f"\n    {values}", style="dim")
    for name, value in (finding.evidence or {}).items():
        text.append(f"\n    {one_line(name)}: {shortened(one_line(str(value)))}", style="dim")
    return text.append(_fix(entry))


def _advised(entry: Listed) -> Text:
    """Return a finding with its message and its fix."""
    return _told(entry).append(_fix(entry))


def _told(entry: Listed) -> Text:
    """Return a finding with its message."""
    return _head(entry).append(f"\n    {one_line(entry.finding.message)}")


def _short(entry: Listed) -> Text:
    """Return a finding on one line."""
    head = _head(entry)
    return head.append(f"  {shortened(one_line(entry.finding.message), max(20, _WIDTH - len(head) - 2))}")


def _head(entry: Listed) -> Text:
    from rich.text import Text

    finding = entry.finding
    text = Text.assemble("  ", (entry.title, f"bold {_COLOURS[entry.result.outcome]}"))
    if finding.path is not None:
        line = "" if finding.line is None else f":{finding.line}"
        text.append(f"  {one_line(joined(entry.target.path, finding.path))}{line}")
    return text


def _fix(entry: Listed) -> str:
    fix = entry.finding.fix
    return "" if fix is None else f"\n    fix: {one_line(fix.text)}"
