"""`xpl sdk`: the part that policies and simulators install."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="The SDK that policies and simulators install.", no_args_is_help=True)


@app.callback()
def sdk() -> None:
    """The SDK that policies and simulators install."""


@app.command()
def build(
    out: Annotated[Path, typer.Option(help="Folder for the wheel; made if missing.", file_okay=False)] = Path("dist"),
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a wheel that has other contents.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object: path, sha256, state.")] = False,
) -> None:
    """Build the SDK alone as a wheel (`xpl-sdk`, Python 3.9 or newer, numpy only).

    For interpreters too old for this tool. Not to be installed beside `xpl-cli`, which contains the SDK.
    """
    from xpl_cli import sdk_wheel

    wheel = sdk_wheel.build(out, overwrite=overwrite)
    if as_json:
        typer.echo(json.dumps({**dataclasses.asdict(wheel), "path": str(wheel.path)}))
    else:
        typer.echo(f"{wheel.state} {wheel.path}")
