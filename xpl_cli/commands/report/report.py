"""`xpl report`: the report of a recorded run as HTML, Markdown, CSV and JSON."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.report import reading
from xpl_cli.commands.report.reading import SKIP_BAD_LINES


@exit_codes(clean="written", not_found="no run there", not_run="a record is damaged, or the folder cannot be written")
def report(
    runs: list[Path] = typer.Argument(..., metavar="RUN...", help="Folders of runs, as `xpl eval --out` fills them."),
    out: Path | None = typer.Option(None, metavar="DIR", help="Folder of the report; RUN/report by default."),
    embed: float = typer.Option(
        16.0, min=0.0, metavar="MB", help="Videos and curves embedded in the page; the rest is linked."
    ),
    skip_bad_lines: bool = SKIP_BAD_LINES,
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object for each run, one a line."),
) -> None:
    """Write a run's report: an HTML page, Markdown, JSON and CSV.

    The files are index.html, report.md, report.json, table.csv and episodes.csv.
    """
    import json

    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError
    from xpl_cli.evaluation.report import report_files

    if out is not None and len(runs) > 1:
        raise UserError(f"--out takes one run, got {len(runs)}")
    for run in reading.runs(runs, skip=skip_bad_lines):
        folder = out or run.folder / report_files.FOLDER
        document = report_files.write(run, folder, int(embed * 1e6))
        if as_json:
            console.data(json.dumps({**document, "next": []}, ensure_ascii=False))
        else:
            console.data(str(folder / report_files.PAGE))
