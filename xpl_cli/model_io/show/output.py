"""Writes the page and the picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io.show.page import page
from xpl_cli.model_io.show.sheet import sheet

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from xpl_cli.model_io.show.report import ShowReport

PAGE: Final = "index.html"
SHEET: Final = "show.png"


def write(report: ShowReport, folder: Path) -> list[str]:
    """Write the page and the picture, and return their paths.

    Raises:
        UserError: if the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        atomic.write_file(folder / PAGE, page(report).encode())
        atomic.write_file(folder / SHEET, sheet(report))
    except OSError as error:
        raise UserError(f"{folder} cannot be written: {error.strerror or error}") from None
    return [str(folder / PAGE), str(folder / SHEET)]


def list_notes(report: ShowReport) -> Iterator[str]:
    """Yield the notes that deserve attention."""
    yield from report.notes
    for view in report.views:
        for note in view.notes:
            yield f"{view.input}, {view.camera}{f', {view.when} ago' if view.when else ''}: {note}"
