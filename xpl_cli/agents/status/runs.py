"""Evaluations of a policy that were recorded below `runs/` of the working directory: done, or cut off in the middle."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.packages.targets import Target

ROOM: Final = "runs"
_MOST: Final = 20


class Course(StrEnum):
    """How far a recorded run is.

    `other_files` is one that was played by other files of the policy than are there now: it says nothing of these.
    """

    COMPLETE = "complete"
    INTERRUPTED = "interrupted"
    OTHER_FILES = "other_files"


@dataclass(frozen=True)
class Recorded:
    """A recorded run.

    Attributes:
        path: its folder.
        environment: what was played.
        episodes: how many have ended.
        unplayed: how many are still to come.
        state: how far it is.
    """

    path: str
    environment: str
    episodes: int
    unplayed: int
    state: Course


def recorded(target: Target) -> tuple[Recorded, ...]:
    """Return the runs of a policy, the newest first; a record that cannot be read is left out."""
    files = sorted(Path(ROOM).glob("*/records.jsonl"), key=lambda file: file.stat().st_mtime, reverse=True)
    found = [_read(file, target) for file in files[:_MOST]]
    return tuple(run for run in found if run is not None)


def _read(file: Path, target: Target) -> Recorded | None:
    from xpl_cli.evaluation.records import cells, records
    from xpl_cli.evaluation.records.fingerprints import package_digest

    try:
        run = records.read(file)
    except UserError:
        return None
    policy = run.plan.policy
    if policy.name != target.path.name:
        return None
    unplayed = sum(cell.unplayed for cell in cells.cells(run))
    state = Course.INTERRUPTED if unplayed else Course.COMPLETE
    if policy.digest != package_digest(target.path):
        state = Course.OTHER_FILES
    return Recorded(str(file.parent), run.plan.environment.name, len(run.finals), unplayed, state)
