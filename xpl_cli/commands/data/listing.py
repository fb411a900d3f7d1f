"""`xpl data list`: what a set of demonstrations holds."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.endings import ends
from xpl_cli.commands.options import JSON

SET = typer.Argument(..., metavar="SET", help="File or folder of demonstrations; its format is found by looking.")


@ends(clean="listed", findings="they are damaged", not_found="no demonstrations there", not_run="a library is missing")
def list_(
    demonstrations: Path = SET,
    as_json: bool = JSON,
) -> None:
    """List a set's episodes, and the columns and cameras that they have."""
    from xpl_cli.basics import console
    from xpl_cli.data.reading import open_set
    from xpl_cli.data.sets.summary import DatasetSummary

    found = DatasetSummary.of(open_set(demonstrations))
    if as_json:
        console.answer("xpl.data-list/1", found.as_json(), [])
    else:
        console.data(found.text)
