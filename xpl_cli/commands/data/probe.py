"""`xpl data probe`: the conventions of demonstrations, measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from xpl_cli.basics.endings import ends
from xpl_cli.commands.data.listing import SET
from xpl_cli.commands.options import JSON

if TYPE_CHECKING:
    from xpl_cli.data.probe.answer import ProbeAnswer


@ends(
    clean="measured, however much stays unknown",
    findings="they are damaged",
    not_found="no demonstrations there",
    not_run="a library is missing",
)
def probe(
    demonstrations: Path = SET,
    episodes: int = typer.Option(24, min=1, metavar="N", help="Episodes that are read, evenly spread."),
    robot: str | None = typer.Option(None, metavar="NAME", help="The robot, where you know it (`xpl spec show`)."),
    explain: Path | None = typer.Option(None, metavar="FILE.html", help="Write a page with the lines that show it."),
    write: Path | None = typer.Option(None, metavar="DRAFT.yml", help="Write a draft of `model_io` and of the robot."),
    as_json: bool = JSON,
) -> None:
    """Measure the conventions of demonstrations instead of believing a README: each with evidence and margin."""
    from xpl_cli.basics import console, output
    from xpl_cli.basics.progress import progress
    from xpl_cli.data.probe import draft, page
    from xpl_cli.data.probe.probe import probe as measured
    from xpl_cli.data.reading import open_set

    for path in (explain, write):
        if path is not None:
            output.check(path)
    opened = open_set(demonstrations)
    with progress() as say:
        found = measured(opened, episodes=episodes, robot=robot, report_progress=say.detail)
    if explain is not None:
        output.write(explain, page.page(found, f"Conventions of {demonstrations.name}"))
    if write is not None:
        output.write(write, draft.draft_yaml(found))
    if as_json:
        document = {
            "path": str(demonstrations),
            "format": opened.format,
            "episodes": found.episodes,
            "rows": found.rows,
            "answers": [answer.document() for answer in found.answers],
        }
        console.answer("xpl.data-probe/1", document, [])
        return
    console.data(_table(found.answers))
    known = sum(answer.is_known for answer in found.answers)
    console.note(f"{known} of {len(found.answers)} known, from {found.episodes} episodes and {found.rows} steps")
    for path in (explain, write):
        if path is not None:
            console.note(f"wrote {path}")


def _table(answers: list[ProbeAnswer]) -> str:
    """Return the answers by what they are of."""
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
