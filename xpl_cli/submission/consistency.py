"""Whether the records of a run agree with their plan and with themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.phrases import join_limited
from xpl_cli.evaluation.records import containment, fingerprints, run_mode
from xpl_cli.evaluation.records.cells import cells
from xpl_cli.evaluation.records.failures import MAX_INFRASTRUCTURE_SHARE, contradiction

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run

_MOST_LISTED = 8
_SLACK_S = 0.01
"""Clocks are read at different moments and rounded."""


def problems(run: Run) -> Iterator[str]:
    """Yield the problems of a run's records, one sentence each.

    `records.read` has checked that lines match the schema, the plan matches the run's name, episodes are of the plan,
    success matches failure, and no episode is final twice or retried without need.
    """
    if run.torn:
        yield "the last line of its records is incomplete: an episode was lost in a crash; `xpl eval --resume` runs it"
    for digest, facts in run.machines.items():
        if fingerprints.digest_of(facts) != digest:
            yield f"machine {digest[:12]} does not have the facts that it is named after"
    for line in run.attempts:
        yield from _episode(line, run)
    if (reason := containment.sentence(run)) is not None:
        yield reason
    if unusual := run_mode.run_mode_of(run.plan).description:
        yield f"it ran {unusual}: its episodes cannot be replayed one by one"
    yield from _attempts(run)
    yield from _copies(run)
    yield from _without_outcome(run)
    if run.has_too_many_infrastructure_errors:
        counts = f"{run.infrastructure_errors} of its {len(run.finals)} episodes ended with an infrastructure error"
        yield f"{counts}, more than {MAX_INFRASTRUCTURE_SHARE:.0%}"
    missing = sum(cell.remaining for cell in cells(run))
    if missing:
        yield f"{missing} of its episodes were not run; `xpl eval --resume` runs them"


def _episode(line: EpisodeRecord, run: Run) -> Iterator[str]:
    """Yield what does not fit in one line of an episode."""
    name = f"episode {line.index}, attempt {line.attempt}"
    for key in ("embodiment", sdk.Deploy.ACTION_TYPE):
        value, planned = getattr(line, key), getattr(run.plan, key)
        if value != planned:
            yield f"{name} has the {key} {value!r}, but its plan says {planned!r}"
    if (problem := contradiction(line)) is not None:
        yield f"{name} {problem}"
    if line.machine not in run.machines:
        yield f"{name} names a machine that the records do not describe"
    inference = line.inference
    if inference is None:
        return
    if inference.seconds > line.wall_seconds + _SLACK_S:
        yield f"{name} took {line.wall_seconds} s, of which {inference.seconds} s waiting for the policy"
    if inference.histogram is not None and sum(inference.histogram) != inference.count:
        yield f"{name} counts {inference.count} round trips, but its histogram has another number of them"


def _attempts(run: Run) -> Iterator[str]:
    """Yield episodes that ended with an infrastructure error before all attempts of the plan were made."""
    most = run.plan.control.attempts
    for index, line in run.finals.items():
        if line.failure == INFRASTRUCTURE and line.attempt < most:
            yield f"episode {index} ended after {line.attempt} attempts: its plan allows {most}"


def _copies(run: Run) -> Iterator[str]:
    """Yield episodes that are copies of others: of their states, although they differ or began at once, or of files."""
    states: dict[str, EpisodeRecord] = {}
    files: dict[str, EpisodeRecord] = {}
    for line in run.finals.values():
        if line.digest is not None and line.steps:
            first = states.setdefault(line.digest, line)
            same = (first.layout, first.steps, first.success) == (line.layout, line.steps, line.success)
            if first is not line and (not same or first.started == line.started):
                yield f"episode {line.index} has the states of episode {first.index}: it was copied"
        for file in filter(None, (line.trace, line.film)):
            if (first := files.setdefault(file.path, line)) is not line:
                yield f"episode {line.index} has {file.path} of episode {first.index}: it was copied"


def _without_outcome(run: Run) -> Iterator[str]:
    """Yield episodes that have neither success nor failure in a task where others have: they would not count."""
    for cell in cells(run):
        silent = [str(line.index) for line in cell.counted if line.success is None and line.failure is None]
        if silent and cell.outcomes:
            names = join_limited(silent, _MOST_LISTED)
            yield f"episodes {names} have neither success nor failure; others in {cell.task} do"
