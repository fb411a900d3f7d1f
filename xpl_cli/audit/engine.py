"""Runs the gates on a target: every rule of a gate, and the next gate only if this one has no failure."""

from __future__ import annotations

import hashlib
import time
from typing import TYPE_CHECKING

from xpl_cli.audit import providers
from xpl_cli.audit.facts import Facts
from xpl_cli.audit.finish import fingerprint
from xpl_cli.audit.model import Gate, GateReport, NotApplicable, NotRun, Outcome, Result, TargetReport
from xpl_cli.audit.registry import Rule, select

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.options import Options


def audit(path: Path, kind: str, options: Options, *, shown: str | None = None) -> TargetReport:
    """Audit one package.

    Args:
        path: its folder.
        kind: `policy` or `env`.
        options: what to run.
        shown: how reports name the folder; the path itself by default.
    """
    report = TargetReport(path=shown or str(path), name=path.name, kind=kind)
    chosen = [item for item in select(options.names, options.ignore, options.gates) if item.target == kind]
    for gate in options.gates:
        selected = [item for item in chosen if item.gate == gate]
        if not selected:
            continue
        blocked = None if options.keep_going else _blocker(report)
        if blocked is not None:
            report.gates.append(_not_started(gate, selected, blocked))
            continue
        options.progress.step(f"{path.name}: {gate} gate, {len(selected)} rules")
        report.gates.append(_run(gate, selected, path, kind, options))
    return report


def _run(gate: Gate, selected: list[Rule], path: Path, kind: str, options: Options) -> GateReport:
    started = time.perf_counter()
    report = GateReport(name=gate)
    with Facts({"path": path, "kind": kind, "options": options}, providers.all_providers()) as facts:
        for item in selected:
            options.progress.detail(f"{path.name}: {gate} gate, {item.code} {item.slug}")
            report.results.append(_check(item, facts))
        report.digest = _digest(report, facts)
    report.fingerprint = fingerprint(gate)
    report.seconds = time.perf_counter() - started
    return report


def _check(item: Rule, facts: Facts) -> Result:
    outcome, reason, findings = Outcome.PASS, None, ()
    try:
        findings = tuple(facts.call(item.check))
        if findings:
            outcome = Outcome.FAIL if item.severity == "must" else Outcome.WARN
    except NotApplicable as why:
        outcome, reason = Outcome.NOT_APPLICABLE, str(why)
    except NotRun as why:
        outcome, reason = Outcome.NOT_RUN, str(why)
    except Exception as error:  # noqa: BLE001 - one rule's crash must not hide what the others found
        outcome, reason = Outcome.ERROR, f"{type(error).__name__}: {error}{_where(error)}"
    return Result(item.code, item.slug, item.requirement, item.severity, outcome, findings, reason)


def _where(error: BaseException) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})" if trace else ""


def _digest(report: GateReport, facts: Facts) -> str:
    """Return a hash of the outcomes and of what the adapter did, as far as the gate's facts recorded it."""
    lines = [f"{result.code} {result.outcome} {len(result.findings)}" for result in report.results]
    return hashlib.sha256("\n".join([*lines, *facts.records()]).encode()).hexdigest()[:16]


def _blocker(report: TargetReport) -> str | None:
    for gate in report.gates:
        if gate.outcome in (Outcome.FAIL, Outcome.ERROR, Outcome.NOT_RUN):
            return f"the {gate.name} gate did not pass"
    return None


def _not_started(gate: Gate, selected: list[Rule], reason: str) -> GateReport:
    results = [
        Result(item.code, item.slug, item.requirement, item.severity, Outcome.NOT_RUN, reason=reason)
        for item in selected
    ]
    return GateReport(name=gate, results=results, reason=reason)
