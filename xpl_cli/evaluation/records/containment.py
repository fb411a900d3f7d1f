"""Runs whose adapter was kept from nothing: it could write into the memory of what judged it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl.vector import INFRASTRUCTURE
from xpl_cli.isolation.isolation_settings import APART, ISOLATED, TRUSTED

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.model import EpisodeRecord
    from xpl_cli.evaluation.records.records import Run

LAUNCHER: Final = "launcher"
"""Fact of a machine that names the benchmark's own launcher, where one played and judged."""


def sentence(run: Run) -> str | None:
    """Return what is to be said of a run in which the adapter may have reached its judge, or None."""
    lines = [line for line in run.finals.values() if not _is_launched(line, run)]
    for applies, reason in (
        (
            lambda line: line.containment == TRUSTED,
            "the system could not keep the adapter from what judges it; `xpl doctor` says what this machine lacks",
        ),
        (_is_unstated, "the record does not say how far the adapter was kept from what judges it"),
    ):
        count = sum(map(applies, lines))
        if count:
            return f"in {count} of its {len(run.finals)} episodes {reason}."
    return None


def remark(run: Run) -> str | None:
    """Return what is to be said of a run that a benchmark's own launcher played, or None."""
    if not any(_is_launched(line, run) for line in run.finals.values()):
        return None
    return "a benchmark's own launcher played and judged it, from which nothing here kept the adapter."


def _is_launched(line: EpisodeRecord, run: Run) -> bool:
    return line.containment is None and LAUNCHER in run.machines.get(line.machine, {})


def _is_unstated(line: EpisodeRecord) -> bool:
    """Tell whether an episode that was played does not say so; what is lost with its player cannot."""
    return line.containment not in (ISOLATED, APART) and line.failure != INFRASTRUCTURE
