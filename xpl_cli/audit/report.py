"""Renders an audit: for people, and as versioned JSON (`xpl.audit/1`, spec/<version>/audit.schema.json)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli import __version__, spec
from xpl_cli.audit.model import Finding, Gate, GateReport, Outcome, Result, TargetReport, counted, exit_code

if TYPE_CHECKING:
    from collections.abc import Sequence

_MARK = {
    Outcome.PASS: ("green", "ok"),
    Outcome.WARN: ("yellow", "warn"),
    Outcome.FAIL: ("red", "FAIL"),
    Outcome.ERROR: ("red", "ERROR"),
    Outcome.NOT_RUN: ("magenta", "not run"),
    Outcome.NOT_APPLICABLE: ("dim", "n/a"),
}
_VERDICT = {"green": "bold green", "red": "bold red", "incomplete": "bold magenta"}


def as_json(reports: Sequence[TargetReport]) -> dict[str, Any]:
    """Return the report as the map that audit.schema.json describes."""
    totals = counted(result for report in reports for result in report.results)
    return {
        "schema": spec.schema("audit")["title"],
        "tool": {"name": "xpl", "version": __version__},
        "spec": spec.CURRENT,
        "targets": [_target(report) for report in reports],
        "summary": {outcome.value: totals[outcome] for outcome in Outcome},
        "exit_code": int(exit_code(reports)),
        "next": next_commands(reports),
    }


def next_commands(reports: Sequence[TargetReport]) -> list[str]:
    """Return the exact commands that are worth running next."""
    broken = [(report, result) for report in reports for result in report.results if result.outcome is Outcome.FAIL]
    if broken:
        codes = list(dict.fromkeys(result.code for _, result in broken))
        paths = " ".join(dict.fromkeys(report.path for report, _ in broken))
        return [*(f"xpl explain {code}" for code in codes[:3]), f"xpl audit {paths}"]
    incomplete = [report for report in reports if report.verdict != "green"]
    if incomplete:
        return [f"xpl serve {report.path}" for report in incomplete]
    return [
        f"xpl eval {report.path} --env {gate.name} --episodes 10"
        for report in reports
        for gate in report.gates
        if gate.name is Gate.MUJOCO and gate.outcome is Outcome.PASS
    ]


def _target(report: TargetReport) -> dict[str, Any]:
    return {
        "path": report.path,
        "name": report.name,
        "kind": report.kind,
        "verdict": report.verdict,
        "gates": [_gate(gate, report) for gate in report.gates],
    }


def _gate(gate: GateReport, report: TargetReport) -> dict[str, Any]:
    return {
        "name": gate.name.value,
        "outcome": gate.outcome.value,
        "reason": gate.reason,
        "seconds": round(gate.seconds, 3),
        "finish": gate.finish,
        "digest": gate.digest,
        "fingerprint": gate.fingerprint,
        "results": [_result(result, report) for result in gate.results],
    }


def _result(result: Result, report: TargetReport) -> dict[str, Any]:
    return {
        "code": result.code,
        "slug": result.slug,
        "requirement": result.requirement,
        "severity": result.severity,
        "outcome": result.outcome.value,
        "reason": result.reason,
        "findings": [_finding(finding, result, report) for finding in result.findings],
    }


def _finding(finding: Finding, result: Result, report: TargetReport) -> dict[str, Any]:
    return {
        "message": finding.message,
        "path": None if finding.path is None else f"{report.path}/{finding.path}",
        "line": finding.line,
        "column": finding.column,
        "end_line": finding.end_line,
        "end_column": finding.end_column,
        "expected": finding.expected,
        "got": finding.got,
        "evidence": None if finding.evidence is None else dict(finding.evidence),
        "fix": None if finding.fix is None else {"kind": finding.fix.kind, "text": finding.fix.text},
        "explain": f"xpl explain {result.code}",
        "fingerprint": finding.fingerprint(result.code),
    }


def as_text(reports: Sequence[TargetReport]) -> Any:
    """Return the report for people, as a rich renderable: passes collapsed, findings in full, next command last."""
    from rich.console import Group
    from rich.text import Text

    parts: list[Any] = []
    for report in reports:
        parts.append(Text.assemble((report.name, "bold"), (f"  {report.path}", "dim")))
        for gate in report.gates:
            parts.extend(_gate_lines(gate, report))
        parts.append(Text.assemble(("verdict  ", "dim"), (report.verdict.upper(), _VERDICT[report.verdict])))
        parts.append(Text(""))
    commands = next_commands(reports)
    if commands:
        parts.append(Text("next", style="dim"))
        parts.extend(Text(f"  {command}") for command in commands)
    return Group(*parts)


def _gate_lines(gate: GateReport, report: TargetReport) -> list[Any]:
    from rich.text import Text

    colour, mark = _MARK[gate.outcome]
    head = Text.assemble((f"{gate.name:<8} ", "bold"), (f"{mark:<8}", colour))
    if gate.reason is not None:
        return [head.append(gate.reason)]
    counts = counted(gate.results)
    head.append(", ".join(f"{counts[outcome]} {_MARK[outcome][1]}" for outcome in Outcome if counts[outcome]))
    lines: list[Any] = [head.append(f"  {gate.seconds:.1f} s", style="dim")]
    lines += [_finding_lines(finding, result, report) for result in gate.results for finding in result.findings]
    lines += [Text(f"  {line}") for line in _unproved(gate)]
    return [*lines, Text(f"  {gate.finish}", style="dim")]


def _unproved(gate: GateReport) -> list[str]:
    """Say once for each reason which rules could not prove anything for it."""
    shown = {Outcome.ERROR, Outcome.NOT_RUN} | ({gate.outcome} & {Outcome.NOT_APPLICABLE})
    by_reason: dict[tuple[Outcome, str | None], list[str]] = {}
    for result in gate.results:
        if result.outcome in shown:
            by_reason.setdefault((result.outcome, result.reason), []).append(f"{result.code} {result.slug}")
    return [
        f"{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: {_MARK[outcome][1]}: {reason}"
        for (outcome, reason), names in by_reason.items()
    ]


def _finding_lines(finding: Finding, result: Result, report: TargetReport) -> Any:
    from rich.text import Text

    colour, _ = _MARK[result.outcome]
    where = (
        "" if finding.path is None else f"{report.path}/{finding.path}" + (f":{finding.line}" if finding.line else "")
    )
    text = Text.assemble(("  ", ""), (f"{result.code} {result.slug}", f"bold {colour}"), (f"  {where}\n", ""))
    text.append(f"    {finding.message}\n")
    if finding.expected is not None:
        text.append(f"    expected {finding.expected}\n", style="dim")
    if finding.got is not None:
        text.append(f"    got      {finding.got}\n", style="dim")
    for key, value in (finding.evidence or {}).items():
        text.append(f"    {key}: {_short(value)}\n", style="dim")
    if finding.fix is not None:
        text.append(f"    fix: {finding.fix.text}\n")
    text.append(f"    explain: xpl explain {result.code}", style="dim")
    return text


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 160 else text[:157] + "..."
