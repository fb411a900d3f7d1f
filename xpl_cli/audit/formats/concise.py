"""`concise`: one line for each finding, as editors and `grep` read it: `path:line:column: CODE message`.

The last lines say what each package comes to.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import Context, Listed, joined, listed, notes, unproved, verdicts
from xpl_cli.basics.strangers import one_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl_cli.audit.rules.model import TargetReport


def render(reports: Sequence[TargetReport], context: Context) -> str:
    """Return the lines; paths are relative to the working directory, so that a terminal can open them."""
    lines = [f"{_where(entry)}: {entry.result.code} {entry.finding.message}" for entry in listed(reports, context)]
    lines += [f"{entry.target.path}: {entry.text}" for entry in unproved(reports, context)]
    lines += [f"{path}: {note}" for path, _, note in notes(reports, context)]
    lines += [f"{target.path}: {verdict}" for target, _, verdict in verdicts(reports, context)]
    return "".join(f"{one_line(line)}\n" for line in lines)


def _where(entry: Listed) -> str:
    finding = entry.finding
    place = (joined(entry.target.path, finding.path), finding.line, finding.column if finding.line else None)
    return ":".join(str(part) for part in place if part is not None)
