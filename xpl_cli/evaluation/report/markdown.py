"""The report as Markdown, for pull requests and papers' appendices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.basics.strangers import in_markdown
from xpl_cli.evaluation.report.view import view
from xpl_cli.evaluation.statistics import wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from xpl_cli.evaluation.records.records import Run


def render(run: Run, summary: Mapping[str, Any]) -> str:
    """Return the report of a run."""
    said = view(run, summary, "")
    parts = [
        f"# {in_markdown(said['policy'])} in {in_markdown(said['environment'])}",
        in_markdown(said["about"]),
        f"**{said['rate']} {said['rate_unit']}** {in_markdown(said['rate_said'])}".replace(" ** ", "** "),
        table(wording.HEADER, wording.table(summary)),
    ]
    if not said["complete"]:
        parts.insert(2, f"This run is not complete: {said['state']}.")
    if said["contrasts"]:
        parts += [f"## {in_markdown(said['contrast_title'])}", in_markdown(said["contrast_said"])]
        parts.append(table(("Task", "Difference"), [(row["name"], row["text"]) for row in said["contrasts"]]))
    parts += ["## Failures", table(("How episodes ended", "Number"), _counted(said["failures"]["parts"], "name"))]
    if said["failures"]["reasons"]:
        parts.append(table(("What ended them", "Number"), _counted(said["failures"]["reasons"], "text")))
    if said["latency"]:
        parts += ["## Latency", in_markdown(said["latency"]["said"])]
    if said["notes"]:
        parts += ["## What these figures do not say", "\n".join(f"- {in_markdown(note)}" for note in said["notes"])]
    parts += ["## What was run", table(("", ""), [(pair["name"], pair["value"]) for pair in said["versions"]])]
    return "\n\n".join(parts) + "\n"


def table(header: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table; what a cell holds is text, whatever it looks like."""
    first, *others = (f"| {' | '.join(in_markdown(str(cell)) for cell in line)} |" for line in (header, *rows))
    return "\n".join([first, f"| {' | '.join(['---'] * len(header))} |", *others])


def _counted(parts: Iterable[Mapping[str, Any]], name: str) -> list[tuple[str, str]]:
    return [(part[name], str(part["count"])) for part in parts]
