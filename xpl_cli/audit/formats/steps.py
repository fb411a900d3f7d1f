"""What to do next, as exact commands."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from xpl_cli.audit.model import Gate, GateReport, Outcome, TargetReport

if TYPE_CHECKING:
    from collections.abc import Sequence

_MOST_RULES = 3


def next_commands(reports: Sequence[TargetReport]) -> list[str]:
    """Return the exact commands that are worth running next, most useful first; each can be pasted into a shell."""
    broken = [(report, result) for report in reports for result in report.results if result.outcome is Outcome.FAIL]
    if broken:
        codes = list(dict.fromkeys(result.code for _, result in broken))
        paths = list(dict.fromkeys(report.path for report, _ in broken))
        again = shlex.join(["xpl", "audit", *paths, *_gates([report for report, _ in broken])])
        repairable = any(
            finding.fix is not None and finding.fix.kind == "safe_edit" and finding.fix.edits
            for _, result in broken
            for finding in result.findings
        )
        repair = [f"{again} --fix"] if repairable else []
        return [*repair, *(f"xpl explain {code}" for code in codes[:_MOST_RULES]), again]
    incomplete = [report for report in reports if report.verdict != "green"]
    if incomplete:
        return [shlex.join(["xpl", "serve", report.path]) for report in incomplete]
    return [
        shlex.join(["xpl", "eval", report.path, "--env", gate.name, "--episodes", "10"])
        for report in reports
        for gate in report.gates
        if _was_driven(gate)
    ]


def _gates(reports: Sequence[TargetReport]) -> list[str]:
    """Return the options that ask for the gates of these reports, none where all were asked for."""
    asked = {gate.name for report in reports for gate in report.gates}
    if asked == set(Gate):
        return []
    return [part for gate in Gate if gate in asked for part in ("--gate", gate.value)]


def _was_driven(gate: GateReport) -> bool:
    return gate.name is Gate.MUJOCO and gate.outcome is Outcome.PASS
