"""How much of an environment's protocol a run covers: all evaluation seeds of a task in a setting, or a subset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.environments import check
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from xpl_cli.evaluation.records.model import PlannedCell


@dataclass(frozen=True)
class SeedCoverage:
    """Evaluation seeds of one task in one setting that a plan uses.

    Attributes:
        task, setting: of the environment.
        seeds: number of planned seeds.
        of: number of evaluation seeds.
    """

    task: str
    setting: str
    seeds: int
    of: int

    @property
    def is_whole(self) -> bool:
        """Whether these are all."""
        return self.seeds == self.of

    def __str__(self) -> str:
        """Return a phrase for a list."""
        return f"{self.seeds} of {self.of} evaluation seeds of {self.task} ({self.setting})"


def seed_coverage(folder: Path, cells: Sequence[PlannedCell]) -> list[SeedCoverage]:
    """Return the coverage of the protocol, task by task; empty for environments without evaluation seeds.

    Args:
        folder: of the environment package.
        cells: of the plan, with tasks that the environment has.
    """
    if not check.has_seeds(folder):
        return []
    facts = environments.manifest(folder)
    return [
        SeedCoverage(cell.task, cell.setting, len(cell.seeds), len(check.seeds(folder, cell.task, cell.setting, facts)))
        for cell in cells
    ]


def seed_error(folder: Path, cell: PlannedCell) -> str | None:
    """Return why the seeds of a cell are not those of an evaluation; None if they are.

    An evaluation uses consecutive evaluation seeds from the index of `--seed`: a free choice could pick those that
    succeed.
    """
    if not check.has_seeds(folder):
        return None
    frozen_seeds, seeds = check.seeds(folder, cell.task, cell.setting), list(cell.seeds)
    name = f"{cell.task} ({cell.setting})"
    if not cell.frozen or not set(seeds) <= set(frozen_seeds):
        return f"the seeds of {name} are not those that {folder.name} has frozen"
    first = frozen_seeds.index(seeds[0]) if seeds else 0
    if frozen_seeds[first : first + len(seeds)] != seeds:
        return f"the seeds of {name} were chosen: expected evaluation seeds of {folder.name} that follow each other"
    return None
