"""The page of a run: one file that holds its styles, its script and its data, and may reach nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.basics import pages
from xpl_cli.evaluation.report import episodes
from xpl_cli.evaluation.report.view import view

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.report.media import EpisodeMedia
    from xpl_cli.evaluation.statistics.summary_model import Summary


def render(run: Run, summary: Summary, media: Mapping[str, EpisodeMedia]) -> str:
    """Return the page of a run.

    Args:
        run: the run.
        summary: of it, `xpl.summary/1`.
        media: of the episodes (`media.collect_media`).
    """
    return pages.render(
        "report/page.html.jinja",
        style="report/page.css",
        script="report/page.js",
        view=view(run, summary, _media_sentence(media)),
        data=pages.as_json({"episodes": episodes.packed(run), "media": media}),
    )


def _media_sentence(media: Mapping[str, EpisodeMedia]) -> str:
    """Return what there is to see of the episodes."""
    films = sum("film" in entry for entry in media.values())
    drawn = sum("curves" in entry or "trace" in entry for entry in media.values())
    if not films and not drawn:
        return "An episode opens at a click. Neither films nor curves were recorded."
    return f"An episode opens at a click; {films} have a film, {drawn} have curves."
