"""Selection of the findings that a branch introduces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import TYPE_CHECKING

from xpl_cli.audit.formats.listing import ListedFinding, ReportContext, listed_findings
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport

if TYPE_CHECKING:
    from xpl_cli.agents.review.change import BranchChange


def is_old(entry: ListedFinding, base_fingerprints: AbstractSet[str], unchanged: AbstractSet[str]) -> bool | None:
    """Tell whether the base has a finding already; None if that is unknown without running the base's code.

    Args:
        entry: the finding.
        base_fingerprints: fingerprints of the static gate's findings in the base.
        unchanged: paths of packages with changed documents only; their findings of other gates are old.
    """
    if entry.gate.name is Gate.STATIC:
        return entry.fingerprint in base_fingerprints
    return True if entry.target.path in unchanged else None


def packages_without_code_changes(change: BranchChange) -> frozenset[str]:
    """Return the paths of the packages with changed documents only."""
    return frozenset(touched.target.shown for touched in change.packages if touched.documents_only)


def without_old_findings(
    reports: Sequence[TargetReport],
    context: ReportContext,
    base_fingerprints: AbstractSet[str],
    unchanged: AbstractSet[str],
) -> list[TargetReport]:
    """Return the reports with old findings counted as passed."""
    old = (
        is_old(entry, base_fingerprints, unchanged) for entry in listed_findings(reports, context)
    )  # in the order of the reports
    return [
        replace(report, gates=[_gate(gate, old, is_unchanged=report.path in unchanged) for gate in report.gates])
        for report in reports
    ]


def _gate(gate: GateReport, old: Iterator[bool | None], *, is_unchanged: bool) -> GateReport:
    results = []
    for result in gate.results:
        is_old_finding = [next(old) for _ in result.findings]
        was_open = result.outcome is Outcome.NOT_RUN and is_unchanged
        passes = all(is_old_finding) if is_old_finding else was_open
        results.append(replace(result, outcome=Outcome.PASS, findings=()) if passes else result)
    return replace(gate, results=results)
