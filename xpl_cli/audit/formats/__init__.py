"""Reports of an audit: for people, for machines, and for code review platforms.

A format is a module with a function `render(reports, context)` that returns text (`xpl_cli.basics.formats`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.audit.formats.listing import ReportContext
from xpl_cli.basics import formats
from xpl_cli.basics.errors import one_of
from xpl_cli.basics.untrusted import escape_controls

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TextIO

    from xpl_cli.audit.rules.model import TargetReport

__all__ = ["ReportContext", "as_json", "check_format", "for_people", "names", "render"]


def names() -> list[str]:
    """Return the names of all formats: ours, then those of installed packages."""
    return list(formats.registered(formats.REPORT))


def render(name: str, reports: Sequence[TargetReport], context: ReportContext | None = None) -> str:
    """Return a report as text that is valid UTF-8 and ends with a line end, or is empty.

    Args:
        name: one of `names`.
        reports: what was audited.
        context: working directory and rules; those of this process by default.
    """
    entry = formats.registered(formats.REPORT)[name]
    text: str = formats.call(entry, "render", reports, context or ReportContext())
    # A file name may contain bytes that are not text.
    text = escape_controls(text.encode(errors="replace").decode())
    return text if not text or text.endswith("\n") else f"{text}\n"


def check_format(name: str) -> str:
    """Return the name of a format.

    Raises:
        UserError: if there is no such format.
    """
    return one_of("--format", name, names())


def as_json(reports: Sequence[TargetReport], context: ReportContext | None = None) -> dict[str, Any]:
    """Return the report as the map that audit.schema.json describes."""
    from xpl_cli.audit.formats import document

    return document.as_json(reports, context or ReportContext())


def for_people(reports: Sequence[TargetReport], context: ReportContext, stream: TextIO) -> str:
    """Return the text report for a stream: coloured for a terminal, plain for a file."""
    from xpl_cli.audit.formats import text
    from xpl_cli.audit.formats.styled_text import OutputStyle

    return text.on_terminal(reports, context, OutputStyle.of(stream)).encode(errors="replace").decode()
