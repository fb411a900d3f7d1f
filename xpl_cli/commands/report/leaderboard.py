"""`xpl leaderboard`: rank recorded runs."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import JSON
from xpl_cli.commands.report import reading
from xpl_cli.commands.report.reading import SKIP_BAD_LINES


@exit_codes(clean="ranked", not_found="no run there", not_run="the runs are not alike, or a record is damaged")
def leaderboard(
    runs: list[Path] = typer.Argument(
        ...,
        metavar="RUN...",
        help="Folders of runs, as `xpl eval --out` fills them; or of RoboDojo's or RoboTwin's results.",
    ),
    by: str = typer.Option("success", metavar="NAME", help="Rank by success, score, or a dimension."),
    tables: bool = typer.Option(False, "--tables", help="Of RoboDojo's results: print Tables II to IV of its paper."),
    common: bool = typer.Option(False, "--common", help="Count only the episodes that all runs have."),
    anyway: bool = typer.Option(
        False, "--anyway", help="Rank in spite of differences between the runs, and name them."
    ),
    out: Path | None = typer.Option(
        None, metavar="DIR", help="Write leaderboard.html, .md, .csv and .json into a folder."
    ),
    robodojo: Path | None = typer.Option(None, metavar="DIR", help="Write each run's _result.json as RoboDojo does."),
    robotwin: Path | None = typer.Option(None, metavar="DIR", help="Write each run's _result.txt as RoboTwin does."),
    skip_bad_lines: bool = SKIP_BAD_LINES,
    as_json: bool = JSON,
) -> None:
    """Rank runs by success rate, with the differences that these episodes do not resolve."""
    import shlex

    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError
    from xpl_cli.evaluation.leaderboard import (
        comparable_runs,
        export,
        leaderboard_files,
        ranking,
        ranking_text,
        result_trees,
    )

    if any(result_trees.is_tree(path) for path in runs):
        if common or robodojo is not None or robotwin is not None:
            raise UserError("--common, --robodojo and --robotwin are for runs of ours: result files know no episodes")
        _of_the_field(runs, by=by, with_tables=tables, partial=anyway, out=out, skip=skip_bad_lines, as_json=as_json)
        return
    if tables:
        raise UserError("--tables is for results of RoboDojo: name a folder with its _result.json files")
    recorded_runs = reading.runs(runs, skip=skip_bad_lines)
    result = ranking.rank(comparable_runs.gather(recorded_runs, common=common, anyway=anyway), by)
    for name, folder in (("robodojo", robodojo), ("robotwin", robotwin)):
        if folder is not None:
            console.note(f"{folder}: {export.write(name, recorded_runs, folder)} files written")
    if out is not None:
        leaderboard_files.write(result, out)
        console.note(f"{out}: written")
    if as_json:
        following = [shlex.join(["xpl", "compare", *map(str, runs[:2])])] if len(runs) > 1 else []
        console.data_json({**result.as_json(), "next": following})
    else:
        console.data(ranking_text.text(result))


def _of_the_field(
    folders: list[Path], *, by: str, with_tables: bool, partial: bool, out: Path | None, skip: bool, as_json: bool
) -> None:
    """Rank result files of other benchmarks."""
    import json

    from xpl_cli.basics import atomic, console
    from xpl_cli.basics.errors import ExitCode, UserError
    from xpl_cli.evaluation.leaderboard import leaderboard_files, policy_scores, result_trees, tables

    results, notes = result_trees.read(folders, skip=skip)
    ranked = tables.rank(policy_scores.score_policies(results, partial=partial), results[0].benchmark, by, notes)
    result_tables = tables.of_the_paper(ranked) if with_tables else [tables.ranking(ranked)]
    if out is not None:
        texts = {".md": tables.as_markdown(ranked, result_tables), ".csv": tables.as_csv(ranked)}
        texts[".json"] = json.dumps(ranked.as_json(), indent=2, ensure_ascii=False) + "\n"
        try:
            out.mkdir(parents=True, exist_ok=True)
            for ending, text in texts.items():
                atomic.write_file(out / f"{leaderboard_files.NAME}{ending}", text.encode(errors="replace"))
        except OSError as error:
            raise UserError(f"{out} cannot be written: {error.strerror}", code=ExitCode.NOT_RUN) from None
        console.note(f"{out}: written")
    if as_json:
        console.data_json({**ranked.as_json(), "next": []})
    else:
        console.data(tables.text(ranked, result_tables))
