"""Which findings of a review count: all of them, or those that the change brings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import Context, Listed, listed
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport

if TYPE_CHECKING:
    from xpl_cli.agents.review.change import Change


def is_old(entry: Listed, known: AbstractSet[str], unchanged: AbstractSet[str]) -> bool | None:
    """Tell whether the base has a finding already; None where nobody can tell without running the base's code.

    Args:
        entry: the finding.
        known: identities of what the static gate finds in the base.
        unchanged: paths of the packages of which only documents change: what a served gate finds there was there.
    """
    if entry.gate.name is Gate.STATIC:
        return entry.fingerprint in known
    return True if entry.target.path in unchanged else None


def unchanged(change: Change) -> frozenset[str]:
    """Return the paths of the packages of which a change touches documents only."""
    return frozenset(touched.target.shown for touched in change.packages if touched.documents_only)


def brought(
    reports: Sequence[TargetReport], context: Context, known: AbstractSet[str], unchanged: AbstractSet[str]
) -> list[TargetReport]:
    """Return the reports with what was there before counted as passed."""
    old = (is_old(entry, known, unchanged) for entry in listed(reports, context))  # in the order of the reports
    return [
        replace(report, gates=[_gate(gate, old, is_unchanged=report.path in unchanged) for gate in report.gates])
        for report in reports
    ]


def _gate(gate: GateReport, old: Iterator[bool | None], *, is_unchanged: bool) -> GateReport:
    results = []
    for result in gate.results:
        found = [next(old) for _ in result.findings]
        was_open = result.outcome is Outcome.NOT_RUN and is_unchanged
        passes = all(found) if found else was_open
        results.append(replace(result, outcome=Outcome.PASS, findings=()) if passes else result)
    return replace(gate, results=results)
