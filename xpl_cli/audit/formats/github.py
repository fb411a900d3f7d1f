"""`github`: workflow commands, which GitHub Actions turns into annotations of a pull request."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import Context, Listed, listed, notes, unproved, verdicts
from xpl_cli.audit.formats.steps import audit_again
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.basics.untrusted import harmless
from xpl_cli.basics.words import amount

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.audit.rules.model import TargetReport

CAP = 10
"""GitHub shows this many annotations of a kind for a step and drops the rest without a word."""


def render(reports: Sequence[TargetReport], context: Context) -> str:
    """Return the commands, and one that says how many were left out."""
    shown: list[str] = []
    counts = {"error": 0, "warning": 0}
    for kind, line in _annotations(reports, context):
        counts[kind] += 1
        if counts[kind] <= CAP:
            shown.append(line)
    said = (command("notice", f"{path}: {note}", title="xpl audit") for path, _, note in notes(reports, context))
    comes_to = (command("notice", f"{path}: {said}", title="xpl audit") for _, path, said in verdicts(reports, context))
    shown += itertools.islice((*comes_to, *said), CAP)
    left_out = [amount(count - CAP, f"more {kind}") for kind, count in counts.items() if count > CAP]
    if left_out:
        again = audit_again(reports, context)
        told = f"{' and '.join(left_out)} not shown here: {CAP} of a kind fit. {again} lists all of them."
        shown.append(command("notice", told, title="xpl audit"))
    return "".join(f"{line}\n" for line in shown)


def _annotations(reports: Sequence[TargetReport], context: Context) -> Iterator[tuple[str, str]]:
    """Yield kind and line of every annotation."""
    for entry in listed(reports, context):
        kind = "error" if entry.fails else "warning"
        yield kind, command(kind, entry.text, **_place(entry), title=entry.title)
    for open_end in unproved(reports, context):
        kind = "error" if open_end.outcome is Outcome.ERROR else "warning"
        yield kind, command(kind, f"{open_end.path}: {open_end.text}", title=open_end.title)


def _place(entry: Listed) -> dict[str, object]:
    """Return where an annotation stands. Columns are allowed only within one line."""
    finding = entry.finding
    if finding.path is None:
        return {}
    end = finding.end_line or finding.line
    columns = (finding.column, finding.end_column) if end == finding.line else (None, None)
    places = {"file": entry.path, "line": finding.line, "endLine": end, "col": columns[0], "endColumn": columns[1]}
    return {name: value for name, value in places.items() if value is not None}


def command(kind: str, message: str, **properties: object) -> str:
    """Return a workflow command, escaped so that no text in it can end it or begin another one."""
    told = ",".join(f"{name}={_property(str(value))}" for name, value in properties.items())
    return f"::{kind} {told}::{_data(message)}"


def _data(text: str) -> str:
    return harmless(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
