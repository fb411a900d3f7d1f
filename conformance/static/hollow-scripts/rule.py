"""XPL190: Behind the scripts for data and training there is something."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.scripts import hollow
from xpl_cli.audit.static.scripts.flow import place
from xpl_cli.audit.static.scripts.hollow import RUN_BY_XPL
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec


@rule(code="XPL190", requirement="XPL-PKG-5")
def hollow_scripts(source: Source) -> Iterator[Finding]:
    """process_data.sh or train.sh has nothing behind it.

    ## What it does
    Looks at what the two scripts run: `xpl prepare` runs process_data.py, `xpl train` runs train.py, `python FILE` that
    file. It reports a script whose file is not there, or does nothing but print, pass or raise, and a script that runs
    nothing at all. A package that declares `evaluation_only: true` is not asked. Where something else runs, it may do
    the work, and nothing is reported.

    A fresh scaffold has the scripts and no Python file: that is an open place of the template like the marked ones, and
    `placeholders` lists it with them as long as there are any. Once they are filled in, the scripts are reported here.
    For the same reason it is a warning.

    ## Why it matters
    The package looks as if everybody could train its policy. Who tries waits for a job to begin, and is told that there
    is no train.py.

    ## Example
    `exec "${XPL:-xpl}" train "$here"` in train.sh, without a train.py.

    ## Use instead
    Write train.py and process_data.py; or declare `evaluation_only: true` in policy.yml and delete the two scripts.

    ## Fix safety
    No automatic fix.
    """
    found = hollow.hollow(source)
    marker = f"{spec.data('package')['placeholder']}:"
    if any(entry.by_xpl for entry in found) and any(marker in source.text(name) for name in source.text_files):
        found = [entry for entry in found if not entry.by_xpl]
        if not found:
            raise NotApplicable(
                "the template's places are still open; the rule placeholders lists these scripts with them"
            )
    for entry in found:
        at = {"path": entry.script} if entry.word is None else place(entry.script, entry.word)
        if not entry.runs:
            message, got = f"{entry.script} does nothing but talk", "no command that does the work"
        elif entry.is_there:
            message, got = (
                f"{entry.script} runs {entry.runs}, which does nothing",
                f"{entry.runs} that only talks or raises",
            )
        else:
            message, got = f"{entry.script} runs {entry.runs}, which is not there", f"no file {entry.runs}"
        wanted = entry.runs or next(name for name in RUN_BY_XPL.values() if name[:5] == entry.script[:5])
        yield Finding(
            f"{message}: nobody can repeat what the package seems to offer",
            **at,
            expected="something that does the work, or evaluation_only: true in policy.yml",
            got=got,
            fix=Fix("advice", f"write {wanted}, or declare evaluation_only: true and delete {entry.script}"),
        )
