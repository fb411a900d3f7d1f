"""Reports of an audit: for people, for machines, and for the places where pull requests are discussed.

A format is a module with a function `render(reports, context)` that returns text. It is imported when it is asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from xpl_cli.audit.formats.listing import Context
from xpl_cli.basics.errors import one_of
from xpl_cli.basics.strangers import harmless

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TextIO

    from xpl_cli.audit.rules.model import TargetReport

__all__ = ["FORMATS", "Context", "as_json", "check_format", "for_people", "render"]

FORMATS = {
    "text": "text",
    "json": "document",
    "sarif": "sarif",
    "github": "github",
    "junit": "junit",
    "rdjson": "rdjson",
}
"""Every format and its module."""


def render(name: str, reports: Sequence[TargetReport], context: Context | None = None) -> str:
    """Return a report as text that is valid UTF-8 and ends with a line end, or is empty.

    Args:
        name: a key of `FORMATS`.
        reports: what was audited.
        context: working directory and rules; those of this process by default.
    """
    text: str = _module(name).render(reports, context or Context())
    # A file name may hold bytes that are no text.
    text = harmless(text.encode(errors="replace").decode())
    return text if not text or text.endswith("\n") else f"{text}\n"


def check_format(name: str) -> str:
    """Return the name of a format.

    Raises:
        UserError: if there is no such format.
    """
    return one_of("--format", name, FORMATS)


def as_json(reports: Sequence[TargetReport], context: Context | None = None) -> dict[str, Any]:
    """Return the report as the map that audit.schema.json describes."""
    document: dict[str, Any] = _module("json").as_json(reports, context or Context())
    return document


def for_people(reports: Sequence[TargetReport], context: Context, stream: TextIO) -> str:
    """Return the text report as what is behind a stream can show it: a terminal in colour, a file plain."""
    from xpl_cli.audit.formats.painted import Terminal

    text: str = _module("text").on_terminal(reports, context, Terminal.of(stream))
    return text.encode(errors="replace").decode()


def _module(name: str) -> Any:
    return import_module(f"{__name__}.{FORMATS[name]}")
