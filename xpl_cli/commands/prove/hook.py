"""`xpl hook`, what pre-commit runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def hook(
    context: typer.Context,
    files: list[Path] | None = typer.Argument(None, metavar="[FILE]...", help="Files that are to be committed."),
    select: list[str] = typer.Option([], "--select", help="As for xpl audit."),
    ignore: list[str] = typer.Option([], "--ignore", help="As for xpl audit."),
    fail_on: str | None = typer.Option(None, "--fail-on", help="As for xpl audit."),
) -> None:
    """Audit, by the static gate, the policies and environments that hold these files; files of none are passed over."""
    from xpl_cli.packages.targets import package_of

    packages = {package: None for file in files or () if (package := package_of(file)) is not None}
    if packages:
        options = [f"--select={name}" for name in select] + [f"--ignore={name}" for name in ignore]
        options += [] if fail_on is None else [f"--fail-on={fail_on}"]
        root: Any = context.find_root().command
        command = ["audit", "--gate=static", *options, "--", *map(str, packages)]
        ended = root.main(command, prog_name=root.name, standalone_mode=False)
        raise typer.Exit(ended if isinstance(ended, int) else 0)
