"""`xpl data probe`: the conventions of demonstrations, measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.data.listing import SET
from xpl_cli.commands.options import JSON

if TYPE_CHECKING:
    from xpl_cli.data.probe.answer import ProbeAnswer


@exit_codes(
    clean="measured; some values may be unknown",
    findings="they are damaged",
    not_found="no demonstrations there",
    not_run="a library is missing",
)
def probe(
    demonstrations: Path = SET,
    episodes: int = typer.Option(24, min=1, metavar="N", help="Episodes that are read, evenly spread."),
    robot: str | None = typer.Option(None, metavar="NAME", help="The robot, where you know it (`xpl spec show`)."),
    explain: Path | None = typer.Option(
        None, metavar="FILE.html", help="Write a page with plots of commands and states."
    ),
    write: Path | None = typer.Option(None, metavar="DRAFT.yml", help="Write a draft of `model_io` and of the robot."),
    as_json: bool = JSON,
) -> None:
    """Measure the conventions of demonstrations, each with its evidence and margin."""
    from xpl_cli.basics import console, output
    from xpl_cli.basics.progress import progress
    from xpl_cli.data.probe import draft, page
    from xpl_cli.data.probe.probe import probe as measured
    from xpl_cli.data.reading import open_set

    for path in (explain, write):
        if path is not None:
            output.check(path)
    opened = open_set(demonstrations)
    with progress() as progress_line:
        result = measured(opened, episodes=episodes, robot=robot, report_progress=progress_line.detail)
    if explain is not None:
        output.write(explain, page.page(result, f"Conventions of {demonstrations.name}"))
    if write is not None:
        output.write(write, draft.draft_yaml(result))
    if as_json:
        document = {
            "path": str(demonstrations),
            "format": opened.format,
            "episodes": result.episodes,
            "rows": result.rows,
            "answers": [answer.document() for answer in result.answers],
        }
        console.answer("xpl.data-probe/1", document, [])
        return
    console.data(_table(result.answers))
    known_count = sum(answer.is_known for answer in result.answers)
    console.note(
        f"{known_count} of {len(result.answers)} known, from {result.episodes} episodes and {result.rows} steps"
    )
    for path in (explain, write):
        if path is not None:
            console.note(f"wrote {path}")


def _table(answers: list[ProbeAnswer]) -> str:
    """Return the answers as text, grouped by subject."""
    subjects: dict[str, list[ProbeAnswer]] = {}
    for answer in answers:
        subjects.setdefault(answer.subject, []).append(answer)
    lines = []
    for subject, own in subjects.items():
        lines.append(subject)
        for one in own:
            margin = "" if one.margin is None else f" ({min(one.margin, 1000):.3g} times better"
            margin += "" if one.margin is None else (f" than {one.second})" if one.second is not None else ")")
            value = one.value if one.is_known else "unknown"
            if isinstance(value, list):
                value = " ".join(f"{item:.4g}" if isinstance(item, float) else str(item) for item in value)
            needs = f"; needed: {one.needs}" if one.needs else ""
            lines.append(f"  {one.topic:<18} {value!s:<22} {one.evidence}{needs}{margin}")
    return "\n".join(lines)
