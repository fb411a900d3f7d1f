"""Differences between two runs besides the policy, which would invalidate a comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from xpl_cli.evaluation.records import run_mode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.evaluation.records.model import PlannedCell, RunPlan
    from xpl_cli.evaluation.records.records import Run


@dataclass(frozen=True)
class RunDifference:
    """One difference between two runs.

    Attributes:
        what: name of it.
        first, second: values of the runs, as text.
    """

    what: str
    first: str
    second: str

    def __str__(self) -> str:
        return f"{self.what}: {self.first} against {self.second}"


def find_differences(first: Run, second: Run) -> list[RunDifference]:
    """Return the differences between two runs besides the policy and its consequences; results are not compared."""
    facts = zip(_facts(first), _facts(second), strict=True)
    return [
        *(
            RunDifference(what, _abbreviate(one), _abbreviate(other))
            for (what, one), (_, other) in facts
            if one != other
        ),
        *_cells(first.plan, second.plan),
        *_machines(first, second),
    ]


def _facts(run: Run) -> Iterator[tuple[str, object]]:
    """Yield the name and value of whatever should be the same."""
    plan = run.plan
    yield "environment", plan.environment.name
    yield "files of the environment", plan.environment.digest
    yield "standard that the environment declares", plan.environment.spec
    yield "standard that the policy declares", plan.policy.spec
    yield "robot", plan.embodiment
    yield "control", plan.action_type
    yield "executed actions of a chunk", plan.control.horizon or "the adapter's own loop"
    yield "episodes at once", run_mode.run_mode_of(plan).num_envs
    yield "instruction", run_mode.run_mode_of(plan).instruction or "the task's"
    yield "attempts at an episode", plan.control.attempts
    yield "width at which a task ends", plan.until_width or "none"


def _cells(first: RunPlan, second: RunPlan) -> Iterator[RunDifference]:
    """Yield tasks and seeds that only one of two plans has."""
    one, other = ({cell.cell_key: cell for cell in plan.cells} for plan in (first, second))
    if one.keys() != other.keys():
        yield RunDifference(
            "tasks that the other lacks", _list_cells(one.keys() - other.keys()), _list_cells(other.keys() - one.keys())
        )
    pairs = [(cell, other[key]) for key, cell in one.items() if key in other]
    for what, describe, unlike in (
        ("seeds", _seeds, [pair for pair in pairs if pair[0].seeds != pair[1].seeds]),
        ("kind of seeds", _kind, [pair for pair in pairs if pair[0].frozen != pair[1].frozen]),
    ):
        if unlike:
            where = _cell_name(unlike[0][0].cell_key) + (f" and {len(unlike) - 1} more" if len(unlike) > 1 else "")
            yield RunDifference(f"{what} of {where}", *map(describe, unlike[0]))


def _machines(first: Run, second: Run) -> Iterator[RunDifference]:
    """Yield the facts of the machines that are not the same in all episodes of both runs."""
    machines = [list(run.machines.values()) for run in (first, second)]
    for name in sorted({name for several in machines for facts in several for name in facts}):
        one, other = ({str(facts.get(name, "unknown")) for facts in several} for several in machines)
        if one != other and one and other:
            yield RunDifference(f"machine: {name}", ", ".join(sorted(one)), ", ".join(sorted(other)))


def _seeds(cell: PlannedCell) -> str:
    return f"{len(cell.seeds)} from {min(cell.seeds)} to {max(cell.seeds)}"


def _kind(cell: PlannedCell) -> str:
    return "the environment's own" if cell.frozen else "counted"


def _cell_name(cell: tuple[str, str]) -> str:
    return f"{cell[0]} ({cell[1]})"


def _list_cells(keys: set[tuple[str, str]]) -> str:
    return ", ".join(map(_cell_name, sorted(keys))) or "none"


def _abbreviate(value: object) -> str:
    """Return a value as people compare it; of a digest the beginning."""
    text = str(value)
    return text[:12] if len(text) == 64 else text
