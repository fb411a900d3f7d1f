"""`xpl compare`."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import JSON
from xpl_cli.commands.report import reading
from xpl_cli.commands.report.reading import SKIP_BAD_LINES


@exit_codes(clean="compared", not_found="no such run", not_run="not comparable, or a record is damaged")
def compare(
    first: Path = typer.Argument(..., metavar="A", help="Folder of a run, such as runs/foo."),
    second: Path = typer.Argument(..., metavar="B", help="Folder of another run."),
    skip_bad_lines: bool = SKIP_BAD_LINES,
    as_json: bool = JSON,
) -> None:
    """Compare two runs by the episodes that both have: which is better, and how certain that is."""
    import shlex

    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError
    from xpl_cli.evaluation.statistics import comparison, verdicts

    runs = reading.runs([first, second], skip=skip_bad_lines)
    if runs[0].folder.resolve() == runs[1].folder.resolve():
        raise UserError(f"{first} and {second} are the same run", hint="name two runs")
    result = comparison.compare(*runs)
    if as_json:
        console.data_json({**result.as_json(), "next": [shlex.join(["xpl", "report", str(first), str(second)])]})
    else:
        console.data(verdicts.text(result))
