"""XPL602: mypy reports no errors in the adapter's own files."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.static.linters import ToolMessage
from xpl_cli.audit.static.source import Source


@rule(code="XPL602", requirement="XPL-ADV-2")
def mypy_errors(source: Source, mypy: tuple[ToolMessage, ...]) -> Iterator[Finding]:
    """The adapter's own files have type errors, reported by mypy.

    ## What it does
    Runs mypy on a copy of the adapter's own Python files. Functions without annotations are checked too. The SDK is
    typed; every other package counts as untyped, so that the result does not depend on installed packages.
    Configuration and plugins in the adapter's folder are not read. It takes seconds, and runs only if it is selected,
    `xpl audit --select advice`.

    ## Why it matters
    A method that returns None on one path, or a tuple where the caller expects a dict, fails in the middle of an
    episode. Such errors do not violate the interface, so they are warnings.

    ## Example
    `def get_action(self) -> list[dict]: return self.queue.pop()` where the queue holds arrays.

    ## Use instead
    Correct the value, or declare its type by an annotation or a check.

    ## Fix safety
    No automatic fix.
    """
    for remark in mypy:
        yield remark.finding(source)
