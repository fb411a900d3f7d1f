"""The files of a report, in a folder that appears whole or not at all."""

from __future__ import annotations

import json
import os
import urllib.parse
from typing import TYPE_CHECKING, Any

from xpl_cli import __version__
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.untrusted import escape_controls
from xpl_cli.evaluation.report import episodes, markdown, media, page
from xpl_cli.evaluation.statistics import wording
from xpl_cli.evaluation.statistics.summary import summarise

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.evaluation.records.records import Run
    from xpl_cli.evaluation.statistics.summary_model import Summary

SCHEMA = "xpl.report/1"
FOLDER = "report"
PAGE, MARKDOWN, DOCUMENT, TABLE, EPISODES = "index.html", "report.md", "report.json", "table.csv", "episodes.csv"


def write(run: Run, folder: Path, budget: int) -> dict[str, Any]:
    """Write page, Markdown, JSON and CSV of a run; return the document.

    Args:
        run: the run.
        folder: is made, or replaced if it holds a report.
        budget: bytes of films and curves that the page may hold; others are linked.

    Raises:
        UserError: if the folder holds something else, or cannot be written.
    """
    _check(folder)
    summary = summarise(run)
    report = document(run, summary)
    link = f"{urllib.parse.quote(os.path.relpath(run.folder.resolve(), folder.resolve()))}/"
    texts = {
        PAGE: page.render(run, summary, media.collect_media(run, budget, link)),
        MARKDOWN: markdown.render(run, summary),
        DOCUMENT: escape_controls(json.dumps(report, indent=2, ensure_ascii=False)) + "\n",
        TABLE: episodes.as_csv(wording.HEADER, wording.table(summary)),
        EPISODES: episodes.table(run),
    }
    try:
        with atomic.replaced_folder(folder) as staging:
            for name, text in texts.items():
                # A task's name may hold what is no text.
                (staging / name).write_bytes(text.encode(errors="replace"))
    except OSError as error:
        raise UserError(f"{folder} cannot be written: {error.strerror}", code=ExitCode.NOT_RUN) from None
    return report


def document(run: Run, summary: Summary) -> dict[str, Any]:
    """Return `xpl.report/1`: what was run, on what, and what came out."""
    return {
        "schema": SCHEMA,
        "tool": {"name": "xpl", "version": __version__},
        "plan": run.plan.as_json(),
        "machines": run.machines,
        "summary": summary.as_json(),
    }


def _check(folder: Path) -> None:
    """Refuse to replace a folder that no report made."""
    if folder.is_dir():
        others = sorted({path.name for path in folder.iterdir()} - {PAGE, MARKDOWN, DOCUMENT, TABLE, EPISODES})
        if others:
            raise UserError(f"{folder} holds more than a report ({others[0]})", hint="name another folder with --out")
    elif folder.exists():
        raise UserError(f"{folder} is a file; a report is a folder", hint="name another folder with --out")
