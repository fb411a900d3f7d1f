"""`xpl data`: list, validate, probe, convert and show demonstrations."""

from __future__ import annotations

import typer

from xpl_cli.commands.data.convert import convert
from xpl_cli.commands.data.declare import declare
from xpl_cli.commands.data.listing import list_
from xpl_cli.commands.data.probe import probe
from xpl_cli.commands.data.show import show
from xpl_cli.commands.data.validate import validate

app = typer.Typer(help="List, validate, probe, convert and show demonstrations.", no_args_is_help=True)

app.command("list")(list_)
app.command()(convert)
app.command()(declare)
app.command()(probe)
app.command()(show)
app.command()(validate)
