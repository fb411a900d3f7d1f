"""`xpl data list`: the episodes, columns and cameras of demonstrations."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import JSON

SET = typer.Argument(..., metavar="SET", help="File or folder of demonstrations, in any known format.")


@exit_codes(clean="listed", findings="they are damaged", not_found="no demonstrations", not_run="a library is missing")
def list_(
    demonstrations: Path = SET,
    as_json: bool = JSON,
) -> None:
    """List a dataset's episodes, columns and cameras."""
    from xpl_cli.basics import console
    from xpl_cli.data.reading import open_set
    from xpl_cli.data.sets.summary import DatasetSummary

    summary = DatasetSummary.of(open_set(demonstrations))
    if as_json:
        console.answer("xpl.data-list/1", summary.as_json(), [])
    else:
        console.data(summary.text)
