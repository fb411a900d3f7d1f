"""What a run claims: numbers of episodes and successes that follow from its records alone."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.records.cells import cells
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.evaluation.records.cells import Cell
    from xpl_cli.evaluation.records.records import Run

_WORD = re.compile(r"[A-Za-z0-9_-]+")


def claim(run: Run) -> dict[str, Any]:
    """Return what a bundle says of a run: an entry of `runs` in submission.schema.json."""
    return {
        "run": run.plan["run"],
        "folder": folder(run),
        "environment": run.plan["environment"]["name"],
        "embodiment": run.plan["embodiment"],
        sdk.Deploy.ACTION_TYPE: run.plan[sdk.Deploy.ACTION_TYPE],
        "cells": [_counts(cell) for cell in cells(run)],
    }


def folder(run: Run) -> str:
    """Return where a run lies in a bundle; what its own folder is called is nobody's business."""
    return f"runs/{run.plan['run'][:12]}"


def environment(run: Run) -> Path:
    """Return the folder of the environment here that bears the name of a run's.

    Raises:
        NotFoundError: there is none.
        UserError: the name is a path, which might lead anywhere, even into a bundle.
    """
    name = run.plan["environment"]["name"]
    if not _WORD.fullmatch(name):
        raise UserError(f"run {run.plan['run'][:12]} names the environment {name!r}: expected the name of a package")
    return environments.find(name)


def _counts(cell: Cell) -> dict[str, Any]:
    return {
        "task": cell.task,
        "setting": cell.setting,
        "planned": cell.planned,
        "played": len(cell.counted),
        "judged": len(cell.outcomes),
        "successes": sum(cell.outcomes),
    }
