"""Runs whose adapter was kept from nothing: it could write into the memory of what judged it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl_cli.isolation.bounds import TRUSTED

if TYPE_CHECKING:
    from xpl_cli.evaluation.records.records import Run


def sentence(run: Run) -> str | None:
    """Return what is to be said of a run in which the system could not keep the adapter from its judge, or None."""
    count = sum(line.containment == TRUSTED for line in run.finals.values())
    if not count:
        return None
    return (
        f"in {count} of its {len(run.finals)} episodes the system could not keep the adapter from what judges it; "
        "`xpl doctor` says what this machine lacks."
    )
