"""Whether the records of a run agree with their plan and with themselves."""

from __future__ import annotations

import json
from collections import defaultdict
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl.vector import INFRASTRUCTURE
from xpl_cli.basics.words import listed
from xpl_cli.evaluation.records import fingerprints
from xpl_cli.evaluation.records.cells import cells
from xpl_cli.evaluation.records.failures import MOST_SPOILT, contradiction, is_open

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.evaluation.records.model import Episode
    from xpl_cli.evaluation.records.records import Run

_SUCCESS_OF = {None: (True, None), "task": (False,), "policy": (False, None), INFRASTRUCTURE: (None,)}
"""What `success` may be for each class of failure."""
_SHOWN = 8
_SLACK_S = 0.01
"""Clocks are read at different moments and rounded."""


def problems(run: Run) -> Iterator[str]:
    """Yield what is wrong with the records of a run, one sentence each.

    That lines are as their schema says, that the plan is what the run is named after, that episodes are of the plan and
    none is final twice, is what `records.read` sees to.
    """
    if run.torn:
        yield "the last line of its records is torn: an episode was lost in a crash; `xpl eval --resume` plays it"
    for digest, facts in run.machines.items():
        if fingerprints.digest_of(facts) != digest:
            yield f"machine {digest[:12]} does not have the facts that it is named after"
    for line in run.attempts:
        yield from _episode(line, run)
    yield from _attempts(run)
    yield from _unjudged(run)
    if run.is_spoilt:
        told = f"{run.spoilt} of its {len(run.finals)} episodes were spoilt by the infrastructure"
        yield f"{told}, more than {MOST_SPOILT:.0%}"
    missing = sum(cell.unplayed for cell in cells(run))
    if missing:
        yield f"{missing} of its episodes were not played; `xpl eval --resume` plays them"


def _episode(line: Episode, run: Run) -> Iterator[str]:
    """Yield what does not fit in one line of an episode."""
    name = f"episode {line.index}, attempt {line.attempt}"
    for key in ("embodiment", sdk.Deploy.ACTION_TYPE):
        told, planned = getattr(line, key), getattr(run.plan, key)
        if told != planned:
            yield f"{name} has the {key} {told!r}, but its plan says {planned!r}"
    if line.success not in _SUCCESS_OF[line.failure]:
        yield f"{name} has success {json.dumps(line.success)} with failure {json.dumps(line.failure)}"
    elif (said := contradiction(line)) is not None:
        yield f"{name} {said}"
    if line.machine not in run.machines:
        yield f"{name} names a machine that the records do not tell of"
    inference = line.inference
    if inference is None:
        return
    if inference.seconds > line.wall_seconds + _SLACK_S:
        yield f"{name} took {line.wall_seconds} s, of which {inference.seconds} s waiting for the policy"
    if inference.histogram is not None and sum(inference.histogram) != inference.count:
        yield f"{name} counts {inference.count} round trips, but its histogram has another number of them"


def _attempts(run: Run) -> Iterator[str]:
    """Yield where an episode was not played as often as the plan says: again where it was spoilt, and only there."""
    by_index: dict[int, list[Episode]] = defaultdict(list)
    for line in run.attempts:
        by_index[line.index].append(line)
    most = run.plan.control.attempts
    for index, lines in sorted(by_index.items()):
        numbers = [line.attempt for line in lines]
        if numbers != list(range(1, len(lines) + 1)) or len(lines) > most:
            told = listed([str(number) for number in numbers], _SHOWN)
            yield f"episode {index} has the attempts {told}: expected 1, 2, ..., at most {most}"
        if lines[-1].final and lines[-1].failure == INFRASTRUCTURE and len(lines) < most:
            yield f"episode {index} was given up after {len(lines)} attempts: its plan allows {most}"
        if not all(is_open(line) for line in lines[:-1]):
            yield f"episode {index} was played again although the infrastructure had not spoilt it"


def _unjudged(run: Run) -> Iterator[str]:
    """Yield episodes that have neither success nor failure in a task where others have: they would not count."""
    for cell in cells(run):
        silent = [str(line.index) for line in cell.counted if line.success is None and line.failure is None]
        if silent and cell.outcomes:
            yield f"episodes {listed(silent, _SHOWN)} neither succeeded nor failed, while others of {cell.task} did"
