"""`json`: the whole report, versioned (`xpl.audit/1`, spec/v1/audit.schema.json)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from xpl_cli import __version__
from xpl_cli.audit.formats.causes import CauseEntry, causes
from xpl_cli.audit.formats.coverage import Coverage
from xpl_cli.audit.formats.listing import ListedFinding, ReportContext, join_path, listed_findings, repository_name
from xpl_cli.audit.formats.next_steps import advice, next_commands
from xpl_cli.audit.rules.model import (
    Finding,
    Fix,
    GateReport,
    Outcome,
    RuleResult,
    TargetReport,
    count_outcomes,
    exit_code,
)
from xpl_cli.audit.rules.verdict import verdict_of
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


def render(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the report as one JSON document."""
    return json.dumps(as_json(reports, context), indent=2, ensure_ascii=False)


def as_json(reports: Sequence[TargetReport], context: ReportContext) -> dict[str, object]:
    """Return the report as the map that audit.schema.json describes."""
    totals = count_outcomes(result for report in reports for result in report.results)
    found = list(listed_findings(reports, context))
    entries = iter(found)  # in the order in which the document names findings
    return {
        "schema": spec.schema("audit")["title"],
        "tool": {"name": "xpl", "version": __version__},
        "spec": spec.VERSION,
        "targets": [_target(report, entries, found, context) for report in reports],
        "summary": {outcome.value: totals[outcome] for outcome in Outcome},
        "exit_code": int(exit_code(reports, context.fail_on)),
        "next": next_commands(reports, context),
        "advice": advice(reports, context),
    }


def finding_as_json(finding: Finding, result: RuleResult, folder: str, fingerprint: str) -> dict[str, object]:
    """Return a finding as a map.

    Args:
        finding: the finding.
        result: what it belongs to.
        folder: the target's folder, relative to the repository.
        fingerprint: the finding's identity.
    """
    return {
        "message": finding.message,
        "path": None if finding.path is None else join_path(folder, finding.path),
        "line": finding.line,
        "located_by": finding.located_by,
        "column": finding.column,
        "end_line": finding.end_line,
        "end_column": finding.end_column,
        "expected": finding.expected,
        "got": finding.got,
        "evidence": None if finding.evidence is None else dict(finding.evidence),
        "fix": None if finding.fix is None else _fix(finding.fix, folder),
        "explain": result.explain,
        "fingerprint": fingerprint,
    }


def _target(
    report: TargetReport, entries: Iterator[ListedFinding], found: Sequence[ListedFinding], context: ReportContext
) -> dict[str, object]:
    folder = repository_name(context.here / report.path, context.here)
    return {
        "path": report.path,
        "name": report.name,
        "kind": report.kind,
        **verdict_of(report).as_json(),
        "gates": [_gate(gate, entries, folder) for gate in report.gates],
        "causes": [_cause(cause) for cause in causes(entry for entry in found if entry.target is report)],
    }


def _cause(cause: CauseEntry) -> dict[str, object]:
    return {
        "harm": cause.harm.name,
        "outcome": (Outcome.FAIL if cause.fails else Outcome.WARN).value,
        "path": cause.located.path if cause.located.finding.path is not None else None,
        "lines": list(cause.lines),
        "codes": [group[0].result.code for group in cause.by_rule],
        "findings": [entry.fingerprint for entry in cause.entries],
    }


def _gate(gate: GateReport, entries: Iterator[ListedFinding], folder: str) -> dict[str, object]:
    return {
        "name": gate.name.value,
        "outcome": gate.outcome.value,
        "reason": gate.reason,
        "seconds": round(gate.seconds, 3),
        "finish": gate.finish,
        "digest": gate.digest,
        "fingerprint": gate.fingerprint,
        "profile": gate.profile.value if gate.profile is not None else None,
        "stood_in": gate.stood_in,
        "figures": [figure.as_json() for figure in gate.measurements],
        **_coverage(gate),
        "results": [_result(result, entries, folder) for result in gate.results],
    }


def _coverage(gate: GateReport) -> dict[str, object]:
    coverage = Coverage.of(gate)
    untried = (
        (("not_applicable", item) for item in coverage.needless),
        (("not_run", item) for item in coverage.prevented),
    )
    return {
        "tried": list(coverage.tried),
        "untried": [
            {"subjects": list(item.subjects), "outcome": outcome, "reason": item.reason}
            for group in untried
            for outcome, item in group
        ],
    }


def _result(result: RuleResult, entries: Iterator[ListedFinding], folder: str) -> dict[str, object]:
    return {
        "code": result.code,
        "slug": result.slug,
        "requirement": result.requirement,
        "severity": result.severity,
        "outcome": result.outcome.value,
        "reason": result.reason,
        "harm": result.harm.name,
        "subject": result.subject,
        **({"lacks": list(result.lacks)} if result.lacks else {}),
        "findings": [finding_as_json(item, result, folder, next(entries).fingerprint) for item in result.findings],
        "waived": [
            {
                **finding_as_json(item.finding, result, folder, _identity(item.finding, result, folder)),
                "reason": item.reason,
            }
            for item in result.waived
        ],
        **({} if result.proof is None else {"proof": dict(result.proof)}),
    }


def _identity(finding: Finding, result: RuleResult, folder: str) -> str:
    return finding.fingerprint(result.code, join_path(folder, finding.path))


def _fix(fix: Fix, folder: str) -> dict[str, object]:
    edits = [
        {
            "path": join_path(folder, edit.path),
            "line": edit.line,
            "column": edit.column,
            "end_line": edit.end_line,
            "end_column": edit.end_column,
            "text": edit.text,
        }
        for edit in fix.edits
    ]
    return {"kind": fix.kind, "text": fix.text, "edits": edits}
