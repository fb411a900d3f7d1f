"""XPL602: mypy has nothing to say about the adapter's own files."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.static.advice import Remark
from xpl_cli.audit.static.source import Source


@rule(code="XPL602", requirement="XPL-ADV-2")
def mypy_finds(source: Source, mypy: tuple[Remark, ...]) -> Iterator[Finding]:
    """The adapter's own files contradict themselves, mypy says.

    ## What it does
    Runs mypy on a copy of the adapter's own Python files. Functions without annotations are looked into. The SDK is
    known; every other package counts as untyped, so that the answer does not depend on what is installed. Configuration
    and plugins of the adapter's folder are not read. It takes seconds, and runs only where it is selected, `xpl audit
    --select advice`.

    ## Why it matters
    A method that returns None on one path, or a tuple where the caller takes a map, fails in the middle of an episode.
    These are no faults of the interface, so they warn.

    ## Example
    `def get_action(self) -> list[dict]: return self.queue.pop()` where the queue holds arrays.

    ## Use instead
    Correct the value, or say by an annotation or a check what it is.

    ## Fix safety
    No automatic fix.
    """
    for remark in mypy:
        yield remark.finding(source)
