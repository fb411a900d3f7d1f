"""`xpl hook`, what pre-commit runs."""

from __future__ import annotations

from pathlib import Path

import typer


def hook(
    files: list[Path] | None = typer.Argument(None, metavar="[FILE]...", help="Files that are to be committed."),
    select: list[str] = typer.Option([], "--select", help="As for xpl audit."),
    ignore: list[str] = typer.Option([], "--ignore", help="As for xpl audit."),
    fail_on: str | None = typer.Option(None, "--fail-on", help="As for xpl audit."),
) -> None:
    """Audit, by the static gate, the policies and environments that hold these files; files of none are passed over."""
    from xpl_cli.main import app

    packages = {package: None for file in files or () if (package := _holding(file)) is not None}
    if packages:
        options = [f"--select={name}" for name in select] + [f"--ignore={name}" for name in ignore]
        options += [] if fail_on is None else [f"--fail-on={fail_on}"]
        app(["audit", "--gate=static", "--format=concise", *options, "--", *map(str, packages)])


def _holding(file: Path) -> Path | None:
    """Return the package that a file belongs to: the outermost, because models vendor whole repositories."""
    return next((folder for folder in reversed(file.parents) if _is_package(folder)), None)


def _is_package(folder: Path) -> bool:
    """Tell a package by its manifest; one of the ecosystem, which has none, by where it is and what it holds."""
    from xpl import _spec as sdk
    from xpl_cli import package

    if any((folder / name).is_file() for name in (sdk.File.POLICY_YML, f"{package.ENV}.yml")):
        return True
    held = (sdk.File.MODEL_PY, sdk.File.DEPLOY_YML)
    return folder.parent.name == package.POLICY and any((folder / name).is_file() for name in held)
