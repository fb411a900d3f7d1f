"""`xpl sdk`: build the SDK for policies and simulators."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="Build the SDK that policies and simulators install.", no_args_is_help=True)


@app.callback()
def sdk() -> None:
    """Build the SDK that policies and simulators install."""


@app.command()
def build(
    out: Annotated[Path, typer.Option(help="Folder for the wheel; made if missing.", file_okay=False)] = Path("dist"),
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a wheel that has other contents.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON object.")] = False,
) -> None:
    """Build the SDK alone as a wheel (`xpl-sdk`, Python 3.9 or newer, numpy only).

    For interpreters too old for this tool. Not to be installed beside `xpl-cli`, which contains the SDK.
    """
    from xpl_cli.basics import console
    from xpl_cli.lifecycle import sdk_wheel

    wheel = sdk_wheel.build(out, overwrite=overwrite)
    if as_json:
        following = [shlex.join(["pip", "install", str(wheel.path)])]
        console.answer("xpl.sdk-build/1", {**dataclasses.asdict(wheel), "path": str(wheel.path)}, following)
    else:
        console.data(f"{wheel.state} {wheel.path}")
