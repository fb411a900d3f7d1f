"""`text`: what a person wants to know; passes collapsed, the next command last.

On a terminal it fits on one screen. In a file every finding is listed, each on one line where they would not fit.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import (
    Context,
    Listed,
    by_reason,
    joined,
    listed,
    shortened,
)
from xpl_cli.audit.formats.painted import Painted, Terminal
from xpl_cli.audit.formats.steps import audit_again, next_commands
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport, counted
from xpl_cli.audit.rules.verdict import Verdict, Word, judged
from xpl_cli.basics.untrusted import one_line
from xpl_cli.basics.words import amount

if TYPE_CHECKING:
    from collections.abc import Sequence

_SCREEN = 29
"""Lines of a screen that findings may take; head, verdict and next commands take the rest."""

_LEAST = 4
"""Lines for the findings of one of many targets."""

_LEAST_TOLD = 40
"""Characters of a message without which it tells nothing."""

_INDENT = 8
"""Columns at both ends of a wrapped line that may stay empty."""

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
_VERDICTS = {
    Word.GREEN: "bold green",
    Word.PARTIAL: "bold cyan",
    Word.SHADOW: "bold yellow",
    Word.OPEN: "bold yellow",
    Word.INCOMPLETE: "bold magenta",
    Word.RED: "bold red",
}


@dataclass(frozen=True)
class _Room:
    """What the findings of one target may take of a screen.

    Attributes:
        lines, width: of the screen.
        is_file: whether there is no screen, so that nothing is left out or cut for one.
    """

    lines: int
    width: int
    is_file: bool


def render(reports: Sequence[TargetReport], context: Context) -> str:
    """Return the report without colours, for a file."""
    return on_terminal(reports, context, Terminal())


def on_terminal(reports: Sequence[TargetReport], context: Context, terminal: Terminal) -> str:
    """Return the report as a terminal is to show it."""
    width = min(terminal.width or _WIDTH, _WIDTH)
    found: dict[int, list[Listed]] = {}
    for entry in listed(reports, context):
        found.setdefault(id(entry.target), []).append(entry)
    room = _Room(max(_LEAST, _SCREEN // max(1, len(found))), width, is_file=terminal.width is None)
    parts: list[Painted] = []
    for report in reports:
        again = audit_again([report], context)
        parts += _target(report, found.get(id(report), []), room, again, alone=len(reports) == 1)
    if len(reports) > 1:
        verdicts = Counter(judged(report).word for report in reports)
        told = ", ".join(f"{verdicts[word]} {word}" for word in reversed(Word) if verdicts[word])
        parts.append(Painted.of((f"{len(reports)} targets: {told}", "bold")))
    commands = next_commands(reports, context)
    if commands:
        parts.append(Painted.of(("next", "dim")))
        parts += [Painted(wraps=False).append(f"  {one_line(command)}") for command in commands]
    return "".join(f"{part.shown(terminal)}\n" for part in parts)


def _target(report: TargetReport, entries: list[Listed], room: _Room, again: str, *, alone: bool) -> list[Painted]:
    """Return the part of one target: short if it is one of several, one line if besides all is well."""
    name, path = one_line(report.name), one_line(report.path)
    verdict = judged(report)
    head = Painted.of((name, "bold"), (f"  {path}", "dim"))
    if not alone:
        head = Painted.of((name, "bold"), (f"  {path}  ", "dim"), *_verdict(verdict))
        if not entries and verdict.word not in (Word.RED, Word.INCOMPLETE):
            return [head]
    lines = [head]
    shown = _fitting(entries, room)
    for gate in report.gates:
        lines += [_gate(gate), *(block for entry, block in shown if entry.gate is gate), *_unproved(gate)]
        lines += [Painted.of("  ", one_line(str(figure))) for figure in gate.figures]
        lines += _waived(gate)
        if alone and gate.finish is not None:
            lines.append(Painted.of((f"  {gate.finish}", "dim")))
    if len(shown) < len(entries):
        more = amount(len(entries) - len(shown), "finding")
        lines.append(Painted.of(f"  {more} more: `{one_line(again)} --output audit.txt` lists all"))
    return [*lines, Painted.of(("verdict  ", "dim"), *_verdict(verdict)) if alone else Painted()]


def _verdict(verdict: Verdict) -> tuple[tuple[str, str], str]:
    """Return what a verdict says, its word in colour."""
    word, said = verdict.word.upper(), one_line(str(verdict))
    return (word, _VERDICTS[verdict.word]), said.removeprefix(word)


def _gate(gate: GateReport) -> Painted:
    """Return the line of a gate: how it ended, and how many rules ended how."""
    head = Painted.of((f"{gate.name:<8} ", "bold"), (f"{_MARKS[gate.outcome]:<8}", _COLOURS[gate.outcome]))
    if gate.reason is not None:
        return head.append(one_line(gate.reason))
    counts = counted(gate.results)
    waived = sum(len(result.waived) for result in gate.results)
    told = [f"{counts[outcome]} {_MARKS[outcome]}" for outcome in Outcome if counts[outcome]]
    head.append(", ".join([*told, *([f"{waived} waived"] if waived else [])]))
    return head.append(f"  {gate.seconds:.1f} s", "dim")


def _unproved(gate: GateReport) -> list[Painted]:
    """Say once for each reason which rules could not prove anything for it."""
    if gate.reason is not None:  # the line of the gate says it
        return []
    outcomes = {Outcome.ERROR, Outcome.NOT_RUN} | ({gate.outcome} & {Outcome.NOT_APPLICABLE})
    lines = [] if gate.stood_in is None else [Painted.of("  ", (one_line(gate.stood_in), _COLOURS[Outcome.WARN]))]
    for (outcome, reason), (first, *others) in by_reason(gate, outcomes).items():
        who = f"{first.code} {first.slug}" + (f" and {len(others)} more" if others else "")
        lines.append(Painted.of("  ", (who, _COLOURS[outcome]), f": {_MARKS[outcome]}: {one_line(reason)}"))
    return lines


def _waived(gate: GateReport) -> list[Painted]:
    """Say once for each rule and reason what the manifest accepts."""
    counts = Counter((result.code, result.slug, item.reason) for result in gate.results for item in result.waived)
    lines = []
    for (code, slug, reason), count in counts.items():
        times = "" if count == 1 else f" ({count} times)"
        lines.append(Painted.of("  ", (f"{code} {slug}", "dim"), f": waived{times}: {shortened(one_line(reason))}"))
    return lines


def _fitting(entries: list[Listed], room: _Room) -> list[tuple[Listed, Painted]]:
    """Return as many findings as fit, failures first, in as much detail as lets all of them fit; all in a file."""
    entries = sorted(entries, key=lambda entry: not entry.fails)
    for failure, warning in _SHAPES:
        blocks = [(entry, (failure if entry.fails else warning)(entry, room)) for entry in entries]
        ends = list(itertools.accumulate(block.height(room.width) for _, block in blocks))
        if not ends or ends[-1] <= room.lines:
            break
    return blocks if room.is_file else blocks[: max(1, sum(end <= room.lines for end in ends))]


def _full(entry: Listed, room: _Room) -> Painted:
    """Return a finding with its message, what was expected, what came, evidence and fix."""
    finding = entry.finding
    pairs = (("expected", finding.expected), ("got", finding.got))
    values = ", ".join(f"{name} {shortened(one_line(value), 80)}" for name, value in pairs if value)
    text = _told(entry, room)
    if values:
        text.append(f"\n    {values}", "dim")
    for name, value in (finding.evidence or {}).items():
        text.append(f"\n    {one_line(name)}: {shortened(one_line(str(value)))}", "dim")
    return text.append(_fix(entry))


def _advised(entry: Listed, room: _Room) -> Painted:
    """Return a finding with its message and its fix."""
    return _told(entry, room).append(_fix(entry))


def _told(entry: Listed, _room: _Room) -> Painted:
    """Return a finding with its message."""
    return _head(entry).append(f"\n    {one_line(entry.finding.message)}")


def _short(entry: Listed, room: _Room) -> Painted:
    """Return a finding on one line, or on two where the place alone fills one."""
    head, message = _head(entry), one_line(entry.finding.message)
    if room.is_file:
        return head.append(f"  {message}")
    free = room.width - len(head.plain) - 2
    most = free if free >= _LEAST_TOLD else free + room.width - _INDENT
    return head.append(f"  {shortened(message, max(_LEAST_TOLD, most))}")


def _head(entry: Listed) -> Painted:
    finding = entry.finding
    text = Painted.of("  ", (entry.title, f"bold {_COLOURS[entry.result.outcome]}"))
    if finding.path is not None:
        line = "" if finding.line is None else f":{finding.line}"
        text.append(f"  {one_line(joined(entry.target.path, finding.path))}{line}")
    return text


def _fix(entry: Listed) -> str:
    fix = entry.finding.fix
    return "" if fix is None else f"\n    fix: {one_line(fix.text)}"


_SHAPES = ((_full, _full), (_advised, _advised), (_advised, _told), (_told, _told), (_told, _short), (_short, _short))
"""How failures and warnings are shown, from the most detail to the least."""
