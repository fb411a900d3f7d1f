"""Runs whose adapter was not isolated: it could write into the memory of the process that judged it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl.vector import INFRASTRUCTURE
from xpl_cli.isolation.isolation_settings import APART, ISOLATED, TRUSTED

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run

LAUNCHER: Final = "launcher"
"""Key of a machine's facts with the name of the benchmark's own launcher, if that ran and judged the episodes."""


def sentence(run: Run) -> str | None:
    """Return a remark on a run in which the adapter may have reached the process that judged it, or None."""
    lines = [line for line in run.finals.values() if not _is_launched(line, run)]
    for applies, reason in (
        (
            lambda line: line.containment == TRUSTED,
            "the system could not isolate the adapter from its judge; `xpl doctor` lists what this machine lacks",
        ),
        (_is_unstated, "the record does not say whether the adapter was isolated from its judge"),
    ):
        count = sum(map(applies, lines))
        if count:
            return f"in {count} of its {len(run.finals)} episodes {reason}."
    return None


def remark(run: Run) -> str | None:
    """Return a remark on a run that a benchmark's own launcher executed, or None."""
    if not any(_is_launched(line, run) for line in run.finals.values()):
        return None
    return "a benchmark's own launcher ran and judged it, without isolation of the adapter."


def _is_launched(line: EpisodeRecord, run: Run) -> bool:
    return line.containment is None and LAUNCHER in run.machines.get(line.machine, {})


def _is_unstated(line: EpisodeRecord) -> bool:
    """Return whether a finished episode has no containment level; an infrastructure error need not have one."""
    return line.containment not in (ISOLATED, APART) and line.failure != INFRASTRUCTURE
