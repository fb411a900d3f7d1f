"""`github`: workflow commands, which GitHub Actions turns into annotations of a pull request.

Each cause is one annotation, the most harmful first.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.causes import CauseEntry, causes
from xpl_cli.audit.formats.listing import ListedFinding, ReportContext, listed_findings, notes, unproven_rules, verdicts
from xpl_cli.audit.formats.next_steps import audit_again
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.basics.phrases import count_noun
from xpl_cli.basics.untrusted import escape_controls

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.audit.rules.model import TargetReport

CAP = 10
"""GitHub shows this many annotations of a kind for a step and silently drops the rest."""


def render(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the commands, and one with the number of those that were left out."""
    lines: list[str] = []
    counts = {"error": 0, "warning": 0}
    for kind, line in _annotations(reports, context):
        counts[kind] += 1
        if counts[kind] <= CAP:
            lines.append(line)
    note_commands = (
        command("notice", f"{path}: {note}", title="xpl audit") for path, _, note in notes(reports, context)
    )
    verdict_commands = (
        command("notice", f"{path}: {said}", title="xpl audit") for _, path, said in verdicts(reports, context)
    )
    lines += itertools.islice((*verdict_commands, *note_commands), CAP)
    left_out = [count_noun(count - CAP, f"more {kind}") for kind, count in counts.items() if count > CAP]
    if left_out:
        again = audit_again(reports, context)
        summary = f"{' and '.join(left_out)} not shown here: {CAP} of a kind fit. {again} lists all of them."
        lines.append(command("notice", summary, title="xpl audit"))
    return "".join(f"{line}\n" for line in lines)


def _annotations(reports: Sequence[TargetReport], context: ReportContext) -> Iterator[tuple[str, str]]:
    """Yield kind and line of every annotation."""
    for cause in causes(listed_findings(reports, context)):
        kind = "error" if cause.fails else "warning"
        yield kind, command(kind, _text(cause), **_annotation_range(cause.located), title=cause.title)
    for open_end in unproven_rules(reports, context):
        kind = "error" if open_end.outcome is Outcome.ERROR else "warning"
        yield kind, command(kind, f"{open_end.path}: {open_end.text}", title=open_end.title)


def _text(cause: CauseEntry) -> str:
    """Return the messages and details of a cause's findings, with the rule and line of each if there are several."""
    if len(cause.entries) == 1:
        return cause.first.text
    return "\n".join(f"{entry.title}{_line(entry)}: {entry.text}" for entry in cause.entries)


def _line(entry: ListedFinding) -> str:
    return "" if entry.finding.line is None else f", line {entry.finding.line}"


def _annotation_range(entry: ListedFinding) -> dict[str, object]:
    """Return file and range of an annotation. Columns are allowed only within one line."""
    finding = entry.finding
    if finding.path is None:
        return {}
    end = finding.end_line or finding.line
    columns = (finding.column, finding.end_column) if end == finding.line else (None, None)
    places = {"file": entry.path, "line": finding.line, "endLine": end, "col": columns[0], "endColumn": columns[1]}
    return {name: value for name, value in places.items() if value is not None}


def command(kind: str, message: str, **properties: object) -> str:
    """Return a workflow command, escaped so that no text in it can end it or begin another one."""
    fields = ",".join(f"{name}={_property(str(value))}" for name, value in properties.items())
    return f"::{kind} {fields}::{_data(message)}"


def _data(text: str) -> str:
    return escape_controls(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
