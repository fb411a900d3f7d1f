"""The report as Markdown, for pull requests and papers' appendices."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.basics.untrusted import in_markdown
from xpl_cli.evaluation.report.view import view
from xpl_cli.evaluation.statistics import wording

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.statistics.summary_model import Summary


def render(run: Run, summary: Summary) -> str:
    """Return the report of a run."""
    page = view(run, summary, "")
    parts = [
        f"# {in_markdown(page.policy)} in {in_markdown(page.environment)}",
        in_markdown(page.about),
        f"**{page.headline.rate} {page.headline.unit}** {in_markdown(page.headline.said)}".replace(" ** ", "** "),
        table(wording.HEADER, wording.table(summary)),
    ]
    if not page.complete:
        parts.insert(2, f"This run is not complete: {page.state}.")
    if page.contrasts.lines:
        parts += [f"## {in_markdown(page.contrasts.title)}", in_markdown(page.contrasts.said)]
        parts.append(table(("Task", "Difference"), [(row.name, row.text) for row in page.contrasts.lines]))
    parts += [
        "## Failures",
        table(("How episodes ended", "Number"), [(part.name, part.count) for part in page.failures.parts]),
    ]
    if page.failures.reasons:
        parts.append(
            table(("What ended them", "Number"), [(reason.text, reason.count) for reason in page.failures.reasons])
        )
    if page.latency:
        parts += ["## Latency", in_markdown(page.latency.said)]
    if page.notes:
        parts += ["## Caveats", "\n".join(f"- {in_markdown(note)}" for note in page.notes)]
    parts += ["## What was run", table(("", ""), [(pair.name, pair.value) for pair in page.versions])]
    return "\n\n".join(parts) + "\n"


def table(header: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; the content of cells is escaped."""
    first, *others = (f"| {' | '.join(in_markdown(str(cell)) for cell in line)} |" for line in (header, *rows))
    return "\n".join([first, f"| {' | '.join(['---'] * len(header))} |", *others])
