"""What the audit report of a bundle comes to: its verdict is made again from what its rules found, and never read.

The report is a file that whoever made the bundle could write. Its outcomes are held against its own findings, its rules
against those that there are, and its static gate, which runs nothing of an adapter, against the adapter in the bundle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, Result, TargetReport
from xpl_cli.audit.rules.registry import entries
from xpl_cli.packages.package import POLICY

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

_GREEN = "green"
_MUST = "must"
_SHOWN = 4


def problems(target: Mapping[str, Any], adapter: Path) -> Iterator[str]:
    """Yield why the report on an adapter does not show that it is green.

    Args:
        target: the report on it, an entry of `targets`.
        adapter: folder of the adapter in the bundle.
    """
    report = _report(target)
    missing = [gate.value for gate in Gate if gate not in {entry.name for entry in report.gates}]
    if missing:
        yield f"the audit ran without the gates {', '.join(missing)}"
    if report.verdict != _GREEN:
        open_rules = [f"{result.code} {result.outcome.value}" for result in report.results if _is_against(result)]
        yield f"the audit is not green: its rules make it {report.verdict} ({_listed(open_rules) or 'nothing passed'})"
    if target["verdict"] != report.verdict:
        yield f"the audit says that it is {target['verdict']}, its rules make it {report.verdict}"
    for gate in report.gates:
        yield from _incomplete(gate)
    yield from _unbound(report, target, adapter)


def _report(target: Mapping[str, Any]) -> TargetReport:
    """Return the report that follows from what the rules found."""
    report = TargetReport(str(target["path"]), str(target["name"]), POLICY, spec=str(target["spec"]))
    for told in target["gates"]:
        gate = GateReport(Gate(told["name"]), digest=told.get("digest"))
        gate.results += [_result(one, report.spec) for one in told["results"]]
        report.gates.append(gate)
    return report


def _result(told: Mapping[str, Any], version: str) -> Result:
    """Return the result of a rule: findings that count make it fail, or warn, whatever it says of itself."""
    rule = next((entry.load() for entry in entries() if entry.code == told["code"]), None)
    severity = told["severity"] if rule is None else rule.severity_in(version)
    outcome = Outcome(told["outcome"])
    if told["findings"]:
        outcome = Outcome.FAIL if severity == _MUST else max(outcome, Outcome.WARN, key=_gravity)
    return Result(told["code"], told["slug"], told["requirement"], severity, outcome, reason=told.get("reason"))


def _incomplete(gate: GateReport) -> Iterator[str]:
    """Yield which rules of a gate the report leaves out or names twice."""
    told = [result.code for result in gate.results]
    known = [entry for entry in entries() if entry.target == POLICY and not entry.is_advice]
    wanted = {entry.code for entry in known if not entry.closes and entry.runs_in(gate.name)}
    if lacking := sorted(wanted.difference(told)):
        yield f"the audit's {gate.name} gate is without the rules {_listed(lacking)}"
    if twice := sorted({code for code in told if told.count(code) > 1}):
        yield f"the audit's {gate.name} gate has two results of {_listed(twice)}"


def _unbound(report: TargetReport, target: Mapping[str, Any], adapter: Path) -> Iterator[str]:
    """Yield where the static gate says something else of the adapter in the bundle."""
    from xpl_cli.audit.engine.engine import audit
    from xpl_cli.audit.rules.options import Options

    told = next((gate for gate in report.gates if gate.name is Gate.STATIC), None)
    if told is None:
        return
    (here,) = audit(adapter, POLICY, Options(gates=(Gate.STATIC,)), shown=str(target["path"])).gates
    if here.outcome != told.outcome:
        yield f"the audit's static gate ended with {told.outcome}; of the adapter in the bundle it says {here.outcome}"
    elif here.digest != told.digest:
        yield (
            f"the audit is not of the adapter in the bundle: its static gate has the digest {told.digest}, and the "
            f"adapter's is {here.digest}"
        )


def _is_against(result: Result) -> bool:
    return result.outcome in {Outcome.FAIL, Outcome.ERROR, Outcome.NOT_RUN}


def _gravity(outcome: Outcome) -> int:
    order = (Outcome.NOT_APPLICABLE, Outcome.PASS, Outcome.WARN, Outcome.NOT_RUN, Outcome.ERROR, Outcome.FAIL)
    return order.index(outcome)


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{', '.join(names[:_SHOWN])}{more}"
