"""XPL601: ruff reports no likely bugs in the adapter's own files."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.static.linters import ToolMessage
from xpl_cli.audit.static.source import Source


@rule(code="XPL601", requirement="XPL-ADV-1")
def ruff_errors(source: Source, ruff: tuple[ToolMessage, ...]) -> Iterator[Finding]:
    """The adapter's own files have likely bugs, reported by ruff.

    ## What it does
    Runs `ruff check` on a copy of the adapter's own Python files, with those of its rules that find bugs and not style:
    F, B, PLE, NPY and unsafe loading of pickles and YAML. Configuration in the adapter's folder is not read; `# noqa`
    in the code is. It runs only if it is selected, `xpl audit --select advice`.

    ## Why it matters
    An undefined name is a NameError in the first episode that reaches it. A mutable default is shared by all instances.
    Such bugs do not violate the interface, so they are warnings.

    ## Example
    `def encode(self, obs, cache={})`.

    ## Use instead
    What ruff recommends: `ruff rule B006`.

    ## Fix safety
    Edits that ruff calls safe are safe here, those that it calls unsafe need `--unsafe-fixes`.
    """
    for remark in ruff:
        yield remark.finding(source)
