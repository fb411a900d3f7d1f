"""`xpl status`: where a package stands, and what to do next."""

from __future__ import annotations

from pathlib import Path

import typer


def status(
    packages: list[Path] = typer.Argument(None, metavar="[PACKAGE]...", help="Adapters or environments, or folders."),
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object."),
) -> None:
    """Tell where packages stand and what to do next. Without PACKAGE all below policy/ and envs/ of this folder.

    Reads files, and what the last audits of the same files found; it runs nothing, and proves nothing by itself. Ends
    with 0 wherever a package stands.
    """
    from xpl_cli.agents.status import standing
    from xpl_cli.basics import console
    from xpl_cli.packages.targets import find_all, find_target, is_package, unique

    named = packages or ([Path()] if is_package(Path.cwd()) else [])
    targets = unique(map(find_target, named)) or find_all()
    standings = [standing.standing(target) for target in targets]
    if as_json:
        console.data_json(standing.document(standings))
    else:
        console.data(standing.text(standings))
