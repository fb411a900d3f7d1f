"""Formats by name: those in which an audit is reported, and those in which demonstrations lie.

Each is a module. A package adds one with an entry point of the group `xpl.formats`, called `report.NAME` or `data.NAME`
(docs/extending.md). Nothing of a format is imported before it is used.
"""

from __future__ import annotations

from typing import Any, Final

from xpl.registry import BUILT_IN_DISTRIBUTION, FORMATS, RegisteredEntry, entries
from xpl_cli.basics.errors import UserError

REPORT, DATA = "report", "data"
_REPORTS, _DATA = "xpl_cli.audit.formats", "xpl_cli.data.formats"
BUILT_IN: Final = {
    f"{REPORT}.text": f"{_REPORTS}.text",
    f"{REPORT}.json": f"{_REPORTS}.document",
    f"{REPORT}.sarif": f"{_REPORTS}.sarif",
    f"{REPORT}.github": f"{_REPORTS}.github",
    f"{REPORT}.junit": f"{_REPORTS}.junit",
    f"{REPORT}.rdjson": f"{_REPORTS}.rdjson",
    f"{DATA}.lerobot": f"{_DATA}.lerobot.reader",
    f"{DATA}.diffusion-policy": f"{_DATA}.diffusion",
    f"{DATA}.rlds": f"{_DATA}.rlds",
    f"{DATA}.robomimic": f"{_DATA}.robomimic",
    f"{DATA}.robotwin": f"{_DATA}.robotwin",
    f"{DATA}.aloha": f"{_DATA}.aloha",
    f"{DATA}.xpl": f"{_DATA}.standard",
}
"""Our own; of two that recognise a set of demonstrations the first reads it."""
REPORTS: Final = tuple(name.partition(".")[2] for name in BUILT_IN if name.startswith(f"{REPORT}."))
"""Names of our own formats of reports."""
REPORTS_HELP: Final = f"{', '.join(REPORTS)}, or one of an installed package."
"""What an option says that takes the format of a report."""


def registered(kind: str) -> dict[str, RegisteredEntry]:
    """Return the formats of a kind, by name: ours, then those of installed packages.

    Raises:
        EntryPointError: two have one name, or one is of no kind.
    """
    found = {}
    for name, entry in entries(FORMATS, BUILT_IN).items():
        prefix, _, rest = name.partition(".")
        if prefix not in (REPORT, DATA) or not rest:
            raise entry.unusable(f"its name is neither {REPORT}.NAME nor {DATA}.NAME")
        if prefix == kind:
            found[rest] = entry
    return found


def call(entry: RegisteredEntry, function: str, *arguments: object) -> Any:
    """Return what a function of a format's module returns.

    Raises:
        EntryPointError: the module cannot be imported or lacks the function, or that of a package raises.
    """
    called = getattr(entry.load(), function, None)
    if not callable(called):
        raise entry.unusable(f"it has no function {function}")
    try:
        return called(*arguments)
    except UserError:
        raise
    except Exception as error:
        if entry.distribution == BUILT_IN_DISTRIBUTION:
            raise
        raise entry.unusable(f"{function} raised {type(error).__name__}: {error}") from error
