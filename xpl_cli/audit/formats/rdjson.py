"""`rdjson`: the diagnostic format of reviewdog, with suggestions that a reviewer accepts with a click.

Its columns count bytes of UTF-8, and the end of a range is the first column after it.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.causes import causes
from xpl_cli.audit.formats.listing import ListedFinding, ReportContext, SourceLines, listed_findings, unproven_rules
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.basics.untrusted import without_links

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.rules.model import TargetReport


def render(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the report as one JSON document."""
    lines = SourceLines()
    found = causes(listed_findings(reports, context))
    diagnostics = [_diagnostic(entry, lines) for cause in found for entry in cause.entries]
    diagnostics += [
        {
            "message": without_links(entry.text),
            "location": {"path": entry.path},
            "severity": "ERROR" if entry.outcome is Outcome.ERROR else "WARNING",
            "code": {"value": entry.results[0].code},
        }
        for entry in unproven_rules(reports, context)
    ]
    return json.dumps({"source": {"name": "xpl"}, "diagnostics": diagnostics}, indent=2, ensure_ascii=False)


def _diagnostic(entry: ListedFinding, lines: SourceLines) -> dict[str, object]:
    finding = entry.finding
    location: dict[str, object] = {"path": entry.path}
    text = None if finding.path is None else lines.of(entry.disk, finding.path)
    if finding.line is not None:
        ends = (finding.line, finding.column), (finding.end_line, finding.end_column)
        location["range"] = _range(text, *ends)
    diagnostic: dict[str, object] = {
        "message": without_links(entry.text),
        "location": location,
        "severity": "ERROR" if entry.fails else "WARNING",
        "code": {"value": entry.result.code},
    }
    suggestion = None if text is None else _suggestion(entry, text)
    if suggestion is not None:
        diagnostic["suggestions"] = [suggestion]
    return diagnostic


_Position = tuple[int | None, int | None]
"""Line and column, both counted from 1, columns in characters."""


def _range(text: list[str] | None, start: _Position, end: _Position) -> dict[str, object]:
    """Return a range. Both ends have columns or neither has: a range with only one has another meaning."""
    ends = {name: position for name, position in (("start", start), ("end", end)) if position[0] is not None}
    columns = {name: byte_column(text, *place) for name, place in ends.items()}
    if None in columns.values():
        return {name: {"line": place[0]} for name, place in ends.items()}
    return {name: {"line": place[0], "column": columns[name]} for name, place in ends.items()}


def byte_column(text: list[str] | None, line: int | None, column: int | None) -> int | None:
    """Convert a column in characters to one in bytes of UTF-8; None if the line is not known."""
    if text is None or line is None or column is None or not 1 <= line <= len(text):
        return None
    return len(text[line - 1][: column - 1].encode(errors="replace")) + 1


def _suggestion(entry: ListedFinding, text: list[str]) -> dict[str, object] | None:
    """Return the edits of a finding as one replacement, because a reviewer accepts one at a time."""
    edits = sorted(entry.finding.fix.edits if entry.finding.fix else (), key=lambda edit: (edit.line, edit.column))
    if not edits or any(edit.path != entry.finding.path or edit.end_line > len(text) for edit in edits):
        return None
    first, last = edits[0], edits[-1]
    replacement, here = "", (first.line, first.column)
    for edit in edits:
        replacement += _between(text, here, (edit.line, edit.column)) + edit.text
        here = (edit.end_line, edit.end_column)
    return {"range": _range(text, (first.line, first.column), (last.end_line, last.end_column)), "text": replacement}


def _between(text: list[str], start: tuple[int, int], end: tuple[int, int]) -> str:
    """Return the text between two positions."""
    lines = text[start[0] - 1 : end[0]]
    lines[-1] = lines[-1][: end[1] - 1]
    lines[0] = lines[0][start[1] - 1 :]
    return "\n".join(lines)
