"""`text`: a report for people; what was tried in few words, findings by harm and cause, the next command last.

On a terminal it fits on one screen. In a file every finding is listed, on one line each if they would not fit.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.causes import CauseEntry, causes
from xpl_cli.audit.formats.coverage import Coverage
from xpl_cli.audit.formats.listing import (
    ListedFinding,
    ReportContext,
    SourceLines,
    join_path,
    listed_findings,
    shortened,
)
from xpl_cli.audit.formats.next_steps import advice, audit_again, next_commands
from xpl_cli.audit.formats.styled_text import OutputStyle, StyledText
from xpl_cli.audit.rules.gates import DEMONSTRATIONS, Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport, count_outcomes
from xpl_cli.audit.rules.verdict import Verdict, VerdictStatus, verdict_of
from xpl_cli.basics.phrases import count_noun, join_limited
from xpl_cli.basics.untrusted import one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from xpl_cli.audit.rules.model import Finding

_SCREEN = 29
"""Lines of a screen for findings; head, verdict and next commands take the rest."""

_REST = 11
"""Lines of a terminal that are not for findings."""

_AROUND = 5
"""Lines of a screen that gates and what was tried may take besides."""

_LEAST_ALONE = 10
"""Least number of lines for the findings of one target."""

_PAGES = 3
"""Screens that a file may take before its findings get one line each."""

_LEAST = 4
"""Least number of lines for the findings of one of many targets."""

_LEAST_TOLD = 40
"""Least number of characters of a message."""

_INDENT = 8
"""Columns at both ends of a wrapped line that may stay empty."""

_WIDTH = 100
_MOST_VALUE = 200
"""Characters of what was expected and what came: a whole error, and no array."""

_MOST_LINES = 12
"""Lines of one cause that are listed in a row."""

_MOST_MESSAGES = 4
"""Findings of one rule and cause whose messages a terminal gets."""

_REASON = 90
"""Characters of the reason why something was not tried."""

_SUBJECTS = 3
"""Things with one reason that are named."""
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
_COUNTED = {
    Outcome.FAIL: "fail",
    Outcome.WARN: "warn",
    Outcome.ERROR: "crashed",
    Outcome.NOT_RUN: "not run",
}
"""Outcomes that the line of a gate counts; what else was tried is listed in words."""
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
        has_headings: whether findings have their harm as a heading; not where several targets share a screen.
        source: lines of the files with findings.
    """

    lines: int
    width: int
    is_file: bool
    has_headings: bool
    source: SourceLines = field(default_factory=SourceLines)


def render(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the report without colours, for a file."""
    return on_terminal(reports, context, OutputStyle())


def on_terminal(reports: Sequence[TargetReport], context: ReportContext, terminal: OutputStyle) -> str:
    """Return the report for a terminal."""
    width = min(terminal.width or _WIDTH, _WIDTH)
    by_target: dict[int, list[CauseEntry]] = {}
    for cause in causes(listed_findings(reports, context)):
        by_target.setdefault(id(cause.first.target), []).append(cause)
    screen = max(_SCREEN, (terminal.height or 0) - _REST)
    lines = max(_LEAST, screen // max(1, len(by_target)))
    is_file = terminal.width is None
    room = _Space(_PAGES * lines if is_file else lines, width, is_file, has_headings=is_file or len(reports) == 1)
    parts: list[StyledText] = []
    for report in reports:
        again = audit_again([report], context)
        parts += _target(report, by_target.get(id(report), []), room, again, alone=len(reports) == 1)
    if len(reports) > 1:
        verdicts = Counter(verdict_of(report).status for report in reports)
        counts = ", ".join(f"{verdicts[word]} {word}" for word in reversed(VerdictStatus) if verdicts[word])
        parts.append(StyledText.of((f"{len(reports)} targets: {counts}", "bold")))
    commands, sentences = next_commands(reports, context), advice(reports, context)
    if commands or sentences:
        parts.append(StyledText.of(("next", "dim")))
        parts += [StyledText.of(f"  {one_line(sentence)}") for sentence in sentences]
        parts += [StyledText(wraps=False).append(f"  {one_line(command)}") for command in commands]
    return "".join(f"{part.render(terminal)}\n" for part in parts)


def _target(
    report: TargetReport, found: list[CauseEntry], room: _Space, again: str, *, alone: bool
) -> list[StyledText]:
    """Return the part of one target: short if it is one of several, one line if it then has no findings."""
    name, path = one_line(report.name), one_line(report.path)
    verdict = verdict_of(report)
    head = StyledText.of((name, "bold"), (f"  {path}", "dim"))
    if not alone:
        head = StyledText.of((name, "bold"), (f"  {path}  ", "dim"), *_verdict(verdict))
        if not found and verdict.status not in (VerdictStatus.RED, VerdictStatus.INCOMPLETE):
            return [head]
    lines = [head]
    for gate in report.gates:
        lines += [_gate(gate), *_unproved(gate, report)]
        lines += [StyledText.of("  ", one_line(str(figure))) for figure in gate.measurements]
        lines += _waived(gate)
        if alone and gate.finish is not None:
            lines.append(StyledText.of((f"  {gate.finish}", "dim")))
    tried = [line for gate in report.gates for line in _tried(gate, report)] if alone else []
    if alone and not room.is_file:
        taken = sum(line.height(room.width) for line in (*lines, *tried))
        room = replace(room, lines=max(_LEAST_ALONE, room.lines + _AROUND - taken))
    fitting = _fit(found, room)
    harm = ""
    for cause, block in fitting:
        if room.has_headings and cause.harm.name != harm and report.kind != DEMONSTRATIONS:
            lines.append(StyledText.of((f"{cause.harm.sentence}:", "bold")))
        harm = cause.harm.name
        lines.append(block)
    if len(fitting) < len(found):
        more = count_noun(len(found) - len(fitting), "finding")
        lines.append(StyledText.of(f"  {more} more: `{one_line(again)} --output audit.txt` lists all"))
    return [*lines, *tried, StyledText.of(("verdict  ", "dim"), *_verdict(verdict)) if alone else StyledText()]


def _verdict(verdict: Verdict) -> tuple[tuple[str, str], str]:
    """Return the text of a verdict, its status in colour."""
    word, said = verdict.status.upper(), one_line(str(verdict))
    return (word, _VERDICTS[verdict.status]), said.removeprefix(word)


def _gate(gate: GateReport) -> StyledText:
    """Return the line of a gate: its outcome, and how many rules found something or could not run."""
    head = StyledText.of((f"{gate.name:<8} ", "bold"), (f"{_MARKS[gate.outcome]:<8}", _COLOURS[gate.outcome]))
    if gate.reason is not None:
        return head.append(one_line(gate.reason))
    counts = count_outcomes(gate.results)
    waived = sum(len(result.waived) for result in gate.results)
    parts = [f"{counts[outcome]} {word}" for outcome, word in _COUNTED.items() if counts[outcome]]
    if gate.outcome is Outcome.NOT_RUN:
        parts = [f"{counts[Outcome.NOT_RUN]} of {count_noun(len(gate.results), 'rule')}"]
    told = ", ".join([*parts, *([f"{waived} waived"] if waived else [])])
    return head.append(told).append(f"{'  ' if told else ''}{gate.seconds:.1f} s", "dim")


def _tried(gate: GateReport, report: TargetReport) -> Iterator[StyledText]:
    """Yield what the rules of a gate tried, and what they did not try because it does not concern the package."""
    coverage = Coverage.of(gate)
    verb = "read" if gate.name is Gate.STATIC else "tried"
    if gate.reason is None and coverage.tried:
        yield StyledText.of((f"{gate.name} {verb}: {', '.join(coverage.tried)}", "dim"))
    if gate.reason is None and coverage.tried and coverage.needless:
        parts = [f"{', '.join(item.subjects)} ({_clause(item.reason, report)})" for item in coverage.needless]
        yield StyledText.of((f"  not {verb}: {', '.join(parts)}", "dim"))


def _clause(reason: str, report: TargetReport) -> str:
    """Return the first clause of a reason."""
    return _reason(re.split(r"[:;] ", reason, maxsplit=1)[0], report)


def _reason(reason: str, report: TargetReport, most: int = _REASON) -> str:
    """Return a reason on one short line, with paths of the package relative to it."""
    folders = "|".join(re.escape(str(folder)) for folder in (Path(report.path).absolute(), report.path))
    return shortened(re.sub(rf"(?<![^\s'\"`(=])({folders})/", "", one_line(reason)), most)


def _unproved(gate: GateReport, report: TargetReport) -> Iterator[StyledText]:
    """Yield a line for each reason with the rules that crashed or could not run for it."""
    if gate.reason is not None:  # it is in the line of the gate
        return
    if gate.stood_in is not None:
        yield StyledText.of("  ", (one_line(gate.stood_in), _COLOURS[Outcome.WARN]))
    for result in gate.results:
        if result.outcome is Outcome.ERROR:
            title = (f"{result.code} {result.slug}", _COLOURS[Outcome.ERROR])
            yield StyledText.of("  ", title, f": {_MARKS[Outcome.ERROR]}: {one_line(result.reason or '')}")
    for item in Coverage.of(gate).prevented:
        codes = ", ".join(result.code for result in item.results)
        codes = codes if len(item.results) <= _SUBJECTS else count_noun(len(item.results), "rule")
        yield StyledText.of(
            "  ", (f"not run, {codes}", _COLOURS[Outcome.NOT_RUN]), f": {_reason(item.reason, report, _MOST_VALUE)}"
        )


def _waived(gate: GateReport) -> list[StyledText]:
    """Return a line for each rule and reason of waived findings."""
    counts = Counter((result.code, result.slug, item.reason) for result in gate.results for item in result.waived)
    lines = []
    for (code, slug, reason), count in counts.items():
        times = "" if count == 1 else f" ({count} times)"
        lines.append(StyledText.of("  ", (f"{code} {slug}", "dim"), f": waived{times}: {shortened(one_line(reason))}"))
    return lines


def _fit(found: list[CauseEntry], room: _Space) -> list[tuple[CauseEntry, StyledText]]:
    """Return as many causes as fit, with as many details as fit; in a file all causes."""
    headings = len({cause.harm.name for cause in found}) if room.has_headings else 0
    blocks: list[tuple[CauseEntry, StyledText]] = []
    for failure, warning in _LAYOUTS:
        blocks = [(cause, (failure if cause.fails else warning)(cause, room)) for cause in found]
        ends = list(itertools.accumulate(block.height(room.width) for _, block in blocks))
        if not ends or ends[-1] + headings <= room.lines:
            break
    return blocks if room.is_file else blocks[: max(1, sum(end + headings <= room.lines for end in ends))]


def _with_evidence(cause: CauseEntry, room: _Space) -> StyledText:
    """Return a cause with its messages, what was expected and what came, evidence and fixes."""
    return _with_messages(cause, room, (_evidence, _fix))


def _with_fix(cause: CauseEntry, room: _Space) -> StyledText:
    """Return a cause with its messages and fixes."""
    return _with_messages(cause, room, (_fix,))


def _with_messages(
    cause: CauseEntry, room: _Space, details: Sequence[Callable[[Finding, str], str]] = ()
) -> StyledText:
    """Return a cause with its messages: of one rule below its title, of several below their line of the file."""
    text = _head(cause, room)
    is_one = len(cause.by_rule) == 1
    told: set[str] = set()
    for group in cause.by_rule:
        indent = "    " if is_one else "      "
        if not is_one:
            text.append("\n    ").append(*_title(group[0]))
        by_message: dict[str, list[ListedFinding]] = {}
        for entry in group:
            by_message.setdefault(entry.finding.message, []).append(entry)
        most = len(by_message) if room.is_file else _MOST_MESSAGES
        for message, (entry, *others) in list(by_message.items())[:most]:
            lines = [place.finding.line for place in (entry, *others) if place.finding.line is not None]
            where = f"{_numbers(lines)}: " if len(by_message) > 1 and len(cause.lines) > 1 and lines else ""
            text.append(f"\n{indent}{where}{one_line(message)}")
            for detail in details:
                if (line := detail(entry.finding, indent)) not in told:
                    text.append(line, "dim")
                told.add(line)
        if len(by_message) > most:
            text.append(f"\n{indent}and {len(by_message) - most} more")
    return text


def _evidence(finding: Finding, indent: str) -> str:
    pairs = (("expected", finding.expected), ("got", finding.got))
    values = ", ".join(f"{name} {shortened(one_line(value), _MOST_VALUE)}" for name, value in pairs if value)
    lines = [values] if values else []
    lines += [
        f"{one_line(name)}: {shortened(one_line(str(value)))}" for name, value in (finding.evidence or {}).items()
    ]
    return "".join(f"\n{indent}{line}" for line in lines)


def _on_one_line(cause: CauseEntry, room: _Space) -> StyledText:
    """Return a cause on one line, or on two if its path alone fills one; in a file each finding on a line."""
    if room.is_file:
        text = StyledText()
        for number, entry in enumerate(cause.entries):
            text.append("\n  " if number else "  ").append(*_title(entry))
            text.append(f"  {_location(entry.target, entry.finding.path, [entry.finding.line])}".rstrip())
            text.append(f"  {one_line(entry.finding.message)}")
        return text
    head = StyledText.of("  ", _title(cause.first, cause.title))
    if where := _location(cause.first.target, cause.located.finding.path, cause.lines):
        head.append(f"  {where}")
    free = room.width - len(head.plain) - 2
    most = free if free >= _LEAST_TOLD else free + room.width - _INDENT
    return head.append(f"  {shortened(one_line(cause.first.finding.message), max(_LEAST_TOLD, most))}")


def _head(cause: CauseEntry, room: _Space) -> StyledText:
    """Return the first line of a cause: the rule and its lines, or the line that several rules point to."""
    place = cause.located.finding
    where = _location(cause.first.target, place.path, cause.lines)
    if len(cause.by_rule) == 1:
        return StyledText.of("  ", _title(cause.first), f"  {where}" if where else "")
    written = room.source.of(cause.first.disk, place.path) if place.path is not None and place.line else None
    text = StyledText.of("  ", (where or one_line(cause.first.target.path), "bold"))
    if written is not None and place.line is not None and place.line <= len(written):
        text.append(f"  {shortened(one_line(written[place.line - 1].strip()), _LEAST_TOLD * 2)}", "dim")
    return text


def _title(entry: ListedFinding, title: str = "") -> tuple[str, str]:
    """Return code and slug of a finding's rule, and whether it only warns, in the colour of the outcome."""
    outcome = entry.result.outcome
    return f"{title or entry.title}{'' if entry.fails else ' (warning)'}", f"bold {_COLOURS[outcome]}"


def _location(target: TargetReport, path: str | None, lines: Sequence[int | None]) -> str:
    if path is None:
        return ""
    numbers = _numbers([line for line in lines if line is not None])
    return f"{one_line(join_path(target.path, path))}{numbers and ':'}{numbers}"


def _numbers(lines: Sequence[int]) -> str:
    return join_limited([str(line) for line in dict.fromkeys(lines)], _MOST_LINES)


def _fix(finding: Finding, indent: str) -> str:
    return "" if finding.fix is None else f"\n{indent}fix: {one_line(finding.fix.text)}"


_LAYOUTS = (
    (_with_evidence, _with_evidence),
    (_with_fix, _with_fix),
    (_with_fix, _with_messages),
    (_with_fix, _on_one_line),
    (_with_messages, _on_one_line),
    (_on_one_line, _on_one_line),
)
"""Layouts of failures and warnings, from most to least detailed."""
