"""`xpl metrics`."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.endings import ends


@ends(clean="measured", not_run="something could not be measured")
def metrics(
    paths: list[Path] | None = typer.Argument(None, metavar="[PATH]...", help="Folders of policies."),
    every: bool = typer.Option(False, "--all", help="Every policy below policy/."),
    plot: Path | None = typer.Option(None, metavar="FILE.svg", help="Write a picture as well."),
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object."),
) -> None:
    """Measure lines of model.py, and loops against the reference. By policy, and over all."""
    from xpl_cli.audit.metrics import measure as measuring
    from xpl_cli.audit.metrics import plot as drawing
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode, UserError

    if every == bool(paths):
        raise UserError("name policies, or give --all: one of the two", hint="`xpl metrics --all`")
    if plot is not None:
        drawing.check(plot)
    measured = [measuring.measure(target) for target in measuring.policies(paths or None)]
    if as_json:
        console.data_json(measuring.document(measured))
    else:
        console.data(measuring.text(measured))
    if plot is not None:
        drawing.write(measured, plot)
        console.note(f"{plot}: written")
    if any(one.reasons for one in measured):
        raise typer.Exit(ExitCode.NOT_RUN)
