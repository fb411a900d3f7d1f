"""Shared by the commands that read recorded runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.evaluation.records.records import Run

SKIP_BAD_LINES = typer.Option(
    False, "--skip-bad-lines", help="Leave out lines of a record that are none, and name them, instead of refusing it."
)


def runs(paths: Sequence[Path], *, skip: bool) -> list[Run]:
    """Read runs; skipped lines are listed on stderr.

    Raises:
        NotFoundError: one of them is not there.
        RecordError: one of them is damaged.
    """
    from xpl_cli.basics import console
    from xpl_cli.evaluation.records import records

    recorded_runs = [records.read(path, skip=skip) for path in paths]
    for run in recorded_runs:
        for line in run.skipped:
            console.note(f"left out: {line}")
    return recorded_runs
