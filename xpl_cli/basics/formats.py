"""Formats by name: of audit reports, and of demonstrations.

Each is a module. A package adds one with an entry point of the group `xpl.formats`, called `report.NAME` or `data.NAME`
(docs/extending.md). A format is imported on first use.
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
"""Built-in formats; the first data format that recognises a set of demonstrations reads it."""
REPORTS: Final = tuple(name.partition(".")[2] for name in BUILT_IN if name.startswith(f"{REPORT}."))
"""Names of the built-in report formats."""
REPORTS_HELP: Final = f"{', '.join(REPORTS)}, or one of an installed package."
"""Help text of options that take a report format."""


def registered(kind: str) -> dict[str, RegisteredEntry]:
    """Return the formats of a kind by name: built-in ones, then those of installed packages.

    Raises:
        EntryPointError: if two have the same name, or one has no kind.
    """
    formats = {}
    for name, entry in entries(FORMATS, BUILT_IN).items():
        prefix, _, rest = name.partition(".")
        if prefix not in (REPORT, DATA) or not rest:
            raise entry.unusable(f"its name is neither {REPORT}.NAME nor {DATA}.NAME")
        if prefix == kind:
            formats[rest] = entry
    return formats


def call(entry: RegisteredEntry, function: str, *arguments: object) -> Any:
    """Call a function of a format's module.

    Raises:
        EntryPointError: if the module cannot be imported or lacks the function, or a third party's function raises.
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
