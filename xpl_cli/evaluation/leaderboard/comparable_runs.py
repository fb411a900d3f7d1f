"""Which runs may be ranked together, and what they have in common."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import containment, mock_settings
from xpl_cli.evaluation.records.cells import cells
from xpl_cli.evaluation.records.failures import MAX_INFRASTRUCTURE_SHARE, contradiction
from xpl_cli.evaluation.statistics.run_differences import RunDifference, find_differences

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.evaluation.records.model import CellKey, EpisodeKey
    from xpl_cli.evaluation.records.records import Run

_MACHINE = "machine: "
_MOST_LISTED = 4
_LONGEST = 100


@dataclass(frozen=True)
class ComparableRuns:
    """Runs that are ranked together.

    Attributes:
        runs: in the order of the command line.
        common: whether they hold only the episodes that all of them have.
        differences: differences from the first run besides the policy: the run's index, and the difference.
        remarks: why requested runs are not among them, and remarks on others, in sentences.
    """

    runs: tuple[Run, ...]
    common: bool
    differences: tuple[tuple[int, RunDifference], ...]
    remarks: tuple[str, ...] = ()

    def sentences(self) -> list[str]:
        """Return the differences as people read them."""
        return [*self.remarks, *(_sentence(self.runs, index, difference) for index, difference in self.differences)]


class IncompatibleRunsError(UserError):
    """Runs whose results would be ranked by more than what their policies can do."""


def gather(runs: Sequence[Run], *, common: bool = False, anyway: bool = False) -> ComparableRuns:
    """Return the runs that can be ranked.

    Args:
        runs: to be ranked.
        common: count only the episodes that all of them have.
        anyway: accept differences and report them.

    Raises:
        IncompatibleRunsError: they differ in tasks, seeds, standard, environment, robot, control or in the number of
            completed episodes.
        UserError: a run was named twice, contradicts itself or used a mock of a part of the benchmark; the runs have
            no episode in common; or all of them have too many infrastructure errors.
    """
    folders = [run.folder.resolve() for run in runs]
    if len(set(folders)) < len(folders):
        raise UserError("a run was named twice", hint="name each run once")
    for run in runs:
        mock_settings.refuse(run, "ranked")
        _refuse_contradictions(run)
    reasons = [_too_many_errors(run) or _not_isolated(run) for run in runs]
    unranked = tuple(filter(None, reasons))
    runs = [run for run, reason in zip(runs, reasons, strict=True) if reason is None]
    if not runs:
        raise UserError(f"no run can be ranked. {' '.join(unranked)}", code=ExitCode.NOT_RUN)
    comparable = tuple(_restrict_to_common(runs)) if common else tuple(runs)
    run_differences = tuple(
        (index, difference)
        for index, run in enumerate(comparable)
        for difference in _differences_from(comparable[0], run)
    )
    barriers = [(index, difference) for index, difference in run_differences if is_barrier(difference.what)]
    if barriers and not anyway:
        more = f" There are {len(barriers) - _MOST_LISTED} more differences." if len(barriers) > _MOST_LISTED else ""
        sentences = " ".join(_sentence(runs, *barrier) for barrier in barriers[:_MOST_LISTED])
        raise IncompatibleRunsError(
            f"these runs are not alike. {sentences}{more}",
            hint="--common ranks by their common episodes, --anyway despite all differences",
            code=ExitCode.NOT_RUN,
        )
    launched = (f"{run.folder}: {remark}" for run in runs if (remark := containment.remark(run)) is not None)
    return ComparableRuns(comparable, common, run_differences, (*unranked, *launched))


def _refuse_contradictions(run: Run) -> None:
    """Raise if the record of an episode contradicts itself about success."""
    for line in run.finals.values():
        problem = contradiction(line)
        if problem is not None:
            raise UserError(
                f"{run.folder}: episode {line.index} {problem}: the record was changed", code=ExitCode.NOT_RUN
            )


def _too_many_errors(run: Run) -> str | None:
    """Return that a run has too many infrastructure errors to be ranked, or None."""
    if not run.has_too_many_infrastructure_errors:
        return None
    return (
        f"{run.folder} is not ranked: {run.infrastructure_errors} of its {len(run.finals)} episodes ended with an "
        f"infrastructure error, more than {MAX_INFRASTRUCTURE_SHARE:.0%}."
    )


def _not_isolated(run: Run) -> str | None:
    """Return why a run is not ranked whose adapter could reach what judged it, or None."""
    reason = containment.sentence(run)
    return None if reason is None else f"{run.folder} is not ranked: {reason}"


def is_barrier(what: str) -> bool:
    """Return whether runs that differ in this are not alike; other machines only get a note."""
    return not what.startswith(_MACHINE)


def _differences_from(first: Run, run: Run) -> Iterator[RunDifference]:
    """Yield in what a run differs from the first one, and whether it still goes on."""
    if run is not first:
        yield from find_differences(first, run)
    remaining = sum(cell.remaining for cell in cells(run))
    if remaining:
        yield RunDifference("remaining episodes", "none", str(remaining))


def _sentence(runs: Sequence[Run], index: int, difference: RunDifference) -> str:
    first, second = (
        textwrap.shorten(text, _LONGEST, placeholder=" ...") for text in (difference.first, difference.second)
    )
    what, folder = f"{difference.what[:1].upper()}{difference.what[1:]}", runs[index].folder
    if index == 0:
        return f"{what}: {second} in {folder}."
    return f"{what}: {first} in {runs[0].folder}, {second} in {folder}."


def _restrict_to_common(runs: Sequence[Run]) -> Iterator[Run]:
    """Yield the runs with the episodes that count in all of them, in the order of the first plan."""
    counted = [set(_counted_cases(run)) for run in runs]
    shared = set.intersection(*counted)
    if not shared:
        raise UserError("these runs have no episode in common", code=ExitCode.NOT_RUN)
    order = [slot for slot in runs[0].plan.slots() if slot.episode_key in shared]
    for run in runs:
        entries = {cell.cell_key: cell for cell in run.plan.cells}
        seeds: dict[CellKey, list[int]] = {}
        for slot in order:
            seeds.setdefault((slot.task, slot.setting), []).append(slot.seed)
        cells = [replace(entries[key], seeds=cell_seeds) for key, cell_seeds in seeds.items()]
        plan = replace(run.plan, until_width=None, cells=cells).named()
        by_case = {line.episode_key: line for line in run.finals.values()}
        finals = {slot.index: replace(by_case[slot.episode_key], index=slot.index) for slot in plan.slots()}
        places_of = {line.episode_key: index for index, line in finals.items()}
        attempts = [
            replace(line, index=places_of[line.episode_key]) for line in run.attempts if line.episode_key in places_of
        ]
        yield replace(run, plan=plan, attempts=attempts, finals=finals)


def _counted_cases(run: Run) -> Iterator[EpisodeKey]:
    """Yield what a run's success rates are made of."""
    for cell in cells(run):
        yield from (line.episode_key for line in cell.counted if cell.counts_as_success(line) is not None)
