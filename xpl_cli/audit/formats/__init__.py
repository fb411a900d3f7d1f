"""Reports of an audit: for people, for machines, and for the places where pull requests are discussed.

A format is a module with a function `render(reports, context)` that returns text (`xpl_cli.basics.formats`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.audit.formats.listing import Context
from xpl_cli.basics import formats
from xpl_cli.basics.errors import one_of
from xpl_cli.basics.untrusted import harmless

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TextIO

    from xpl_cli.audit.rules.model import TargetReport

__all__ = ["Context", "as_json", "check_format", "for_people", "names", "render"]


def names() -> list[str]:
    """Return the names of all formats: ours, then those of installed packages."""
    return list(formats.registered(formats.REPORT))


def render(name: str, reports: Sequence[TargetReport], context: Context | None = None) -> str:
    """Return a report as text that is valid UTF-8 and ends with a line end, or is empty.

    Args:
        name: one of `names`.
        reports: what was audited.
        context: working directory and rules; those of this process by default.
    """
    entry = formats.registered(formats.REPORT)[name]
    text: str = formats.call(entry, "render", reports, context or Context())
    # A file name may hold bytes that are no text.
    text = harmless(text.encode(errors="replace").decode())
    return text if not text or text.endswith("\n") else f"{text}\n"


def check_format(name: str) -> str:
    """Return the name of a format.

    Raises:
        UserError: if there is no such format.
    """
    return one_of("--format", name, names())


def as_json(reports: Sequence[TargetReport], context: Context | None = None) -> dict[str, Any]:
    """Return the report as the map that audit.schema.json describes."""
    from xpl_cli.audit.formats import document

    return document.as_json(reports, context or Context())


def for_people(reports: Sequence[TargetReport], context: Context, stream: TextIO) -> str:
    """Return the text report as what is behind a stream can show it: a terminal in colour, a file plain."""
    from xpl_cli.audit.formats import text
    from xpl_cli.audit.formats.painted import Terminal

    return text.on_terminal(reports, context, Terminal.of(stream)).encode(errors="replace").decode()
