"""The report as Markdown, for pull requests and papers' appendices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.evaluation.report.view import view
from xpl_cli.evaluation.statistics import wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from xpl_cli.evaluation.records.records import Run


def render(run: Run, summary: Mapping[str, Any]) -> str:
    """Return the report of a run."""
    said = view(run, summary, "")
    parts = [
        f"# {escape(said['policy'])} in {escape(said['environment'])}",
        escape(said["about"]),
        f"**{said['rate']} {said['rate_unit']}** {escape(said['rate_said'])}".replace(" ** ", "** "),
        table(wording.HEADER, wording.table(summary)),
    ]
    if not said["complete"]:
        parts.insert(2, f"This run is not complete: {said['state']}.")
    if said["contrasts"]:
        parts += [f"## {escape(said['contrast_title'])}", escape(said["contrast_said"])]
        parts.append(table(("Task", "Difference"), [(row["name"], row["text"]) for row in said["contrasts"]]))
    parts += ["## Failures", table(("How episodes ended", "Number"), _counted(said["failures"]["parts"], "name"))]
    if said["failures"]["reasons"]:
        parts.append(table(("What ended them", "Number"), _counted(said["failures"]["reasons"], "text")))
    if said["latency"]:
        parts += ["## Latency", escape(said["latency"]["said"])]
    if said["notes"]:
        parts += ["## What these figures do not say", "\n".join(f"- {escape(note)}" for note in said["notes"])]
    parts += ["## What was run", table(("", ""), [(pair["name"], pair["value"]) for pair in said["versions"]])]
    return "\n\n".join(parts) + "\n"


def table(header: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table; what a cell holds is text, whatever it looks like."""
    first, *others = (f"| {' | '.join(escape(str(cell)) for cell in line)} |" for line in (header, *rows))
    return "\n".join([first, f"| {' | '.join(['---'] * len(header))} |", *others])


def escape(text: str) -> str:
    """Return a text that Markdown shows as it is, on one line."""
    flat = " ".join(text.split())
    for mark in "\\`*_[]<>|":
        flat = flat.replace(mark, f"\\{mark}")
    return flat


def _counted(parts: Iterable[Mapping[str, Any]], name: str) -> list[tuple[str, str]]:
    return [(part[name], str(part["count"])) for part in parts]
