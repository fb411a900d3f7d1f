"""`xpl leaderboard`: many recorded runs, ranked."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.endings import ends
from xpl_cli.commands.report import reading
from xpl_cli.commands.report.reading import SKIP_BAD_LINES


@ends(clean="ranked", not_found="no run there", not_run="the runs are not alike, or a record is damaged")
def leaderboard(
    runs: list[Path] = typer.Argument(..., metavar="RUN...", help="Folders of runs, as `xpl eval --out` fills them."),
    common: bool = typer.Option(False, "--common", help="Count only the episodes that all runs played."),
    anyway: bool = typer.Option(
        False, "--anyway", help="Rank in spite of differences between the runs, and name them."
    ),
    out: Path | None = typer.Option(
        None, metavar="DIR", help="Write leaderboard.html, .md, .csv and .json into a folder."
    ),
    robodojo: Path | None = typer.Option(None, metavar="DIR", help="Write each run's _result.json as RoboDojo does."),
    robotwin: Path | None = typer.Option(None, metavar="DIR", help="Write each run's _result.txt as RoboTwin does."),
    skip_bad_lines: bool = SKIP_BAD_LINES,
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object."),
) -> None:
    """Rank runs by success rate. Names those that these episodes do not tell apart."""
    import shlex

    from xpl_cli.basics import console
    from xpl_cli.evaluation.leaderboard import board, export, field, ranking, written

    found = reading.runs(runs, skip=skip_bad_lines)
    result = ranking.rank(field.gather(found, common=common, anyway=anyway))
    for name, folder in (("robodojo", robodojo), ("robotwin", robotwin)):
        if folder is not None:
            console.note(f"{folder}: {export.write(name, found, folder)} files written")
    if out is not None:
        written.write(result, out)
        console.note(f"{out}: written")
    if as_json:
        following = [shlex.join(["xpl", "compare", *map(str, runs[:2])])] if len(runs) > 1 else []
        console.data_json({**result, "next": following})
    else:
        console.data(board.text(result))
