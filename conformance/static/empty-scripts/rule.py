"""XPL190: The scripts for data conversion and training run something."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.scripts import empty_scripts as scripts
from xpl_cli.audit.static.scripts.empty_scripts import RUN_BY_XPL
from xpl_cli.audit.static.scripts.flow import word_location
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec


@rule(code="XPL190", requirement="XPL-PKG-5")
def empty_scripts(source: Source) -> Iterator[Finding]:
    """process_data.sh or train.sh runs nothing.

    ## What it does
    Looks at what the two scripts run: `xpl prepare` runs process_data.py, `xpl train` runs train.py, `python FILE` that
    file. It reports a script whose file is missing, or only prints, passes or raises, and a script that runs nothing.
    Not reported: a package that declares `evaluation_only: true`, and a script that runs any other program.

    A fresh scaffold has the scripts but no Python file. `placeholders` lists them as long as the template's marked
    placeholders remain; afterwards this rule reports them. For the same reason it is a warning.

    ## Why it matters
    The package looks as if every user could train its policy. A user who tries waits for a job to start, and then gets
    the error that there is no train.py.

    ## Example
    `exec "${XPL:-xpl}" train "$here"` in train.sh, without a train.py.

    ## Use instead
    Write train.py and process_data.py; or declare `evaluation_only: true` in policy.yml and delete the two scripts.

    ## Fix safety
    No automatic fix.
    """
    empty = scripts.empty_scripts(source)
    marker = f"{spec.data('package')['placeholder']}:"
    if any(entry.by_xpl for entry in empty) and any(marker in source.text(name) for name in source.text_files):
        empty = [entry for entry in empty if not entry.by_xpl]
        if not empty:
            raise NotApplicable(
                "placeholders of the template remain; the rule placeholders lists these scripts with them"
            )
    for entry in empty:
        at = {"path": entry.script} if entry.word is None else word_location(entry.script, entry.word)
        if not entry.runs:
            message, got = f"{entry.script} only prints", "no command that does the work"
        elif entry.exists:
            message, got = (
                f"{entry.script} runs {entry.runs}, which does nothing",
                f"{entry.runs} that only prints or raises",
            )
        else:
            message, got = f"{entry.script} runs {entry.runs}, which does not exist", f"no file {entry.runs}"
        run_file = entry.runs or next(name for name in RUN_BY_XPL.values() if name[:5] == entry.script[:5])
        yield Finding(
            f"{message}: users cannot reproduce the training that the package seems to provide",
            **at,
            expected="a program that does the work, or evaluation_only: true in policy.yml",
            got=got,
            fix=Fix("advice", f"write {run_file}, or declare evaluation_only: true and delete {entry.script}"),
        )
