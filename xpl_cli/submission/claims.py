"""What a run claims: numbers of episodes and successes that follow from its records alone."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from xpl_cli.basics.errors import UserError
from xpl_cli.evaluation.records.cells import cells
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.evaluation.records.cells import Cell
    from xpl_cli.evaluation.records.records import Run

_WORD = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class CellClaim:
    """Numbers of episodes of one task in one setting: planned, completed, with defined success, successful."""

    task: str
    setting: str
    planned: int
    completed: int
    judged: int
    successes: int


@dataclass(frozen=True)
class RunClaim:
    """The claim of a run: an entry of `runs` in submission.schema.json.

    Attributes:
        run: its name.
        folder: of its records.jsonl.
        environment, embodiment, action_type: as in its plan.
        cells: the numbers.
    """

    run: str
    folder: str
    environment: str
    embodiment: str
    action_type: str
    cells: Sequence[CellClaim]

    @classmethod
    def parse(cls, data: Mapping[str, Any]) -> Self:
        """Return the claim that a valid manifest makes."""
        return cls(**{**data, "cells": [CellClaim(**cell) for cell in data["cells"]]})

    def total(self, name: str) -> int:
        """Return the sum of one of the numbers over all cells."""
        return sum(getattr(cell, name) for cell in self.cells)


def claim_of(run: Run) -> RunClaim:
    """Return the claim of a run."""
    return RunClaim(
        run.plan.run,
        folder(run),
        run.plan.environment.name,
        run.plan.embodiment,
        run.plan.action_type,
        [_counts(cell) for cell in cells(run)],
    )


def folder(run: Run) -> str:
    """Return the folder of a run in a bundle; the name of its own folder stays private."""
    return f"runs/{run.plan.run[:12]}"


def environment_folder(run: Run) -> Path:
    """Return the folder of the environment here that bears the name of a run's.

    Raises:
        NotFoundError: there is none.
        UserError: the name is a path, which might lead anywhere, even into a bundle.
    """
    name = run.plan.environment.name
    if not _WORD.fullmatch(name):
        raise UserError(f"run {run.plan.run[:12]} names the environment {name!r}: expected the name of a package")
    return environments.find(name)


def _counts(cell: Cell) -> CellClaim:
    outcomes = cell.outcomes
    return CellClaim(cell.task, cell.setting, cell.planned, len(cell.counted), len(outcomes), sum(outcomes))
