"""The audit report of a bundle: its verdict is derived again from the rules' findings, and never trusted.

The maker of the bundle could have written the report. Its outcomes are compared with its own findings, its rules with
the existing ones, and its static gate, which runs nothing of an adapter, with that of the adapter in the bundle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

from xpl import _spec as sdk
from xpl_cli.audit.engine.circumstances import package_circumstances
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Finding, GateReport, Outcome, RuleResult, TargetReport, Waived
from xpl_cli.audit.rules.profiles import Profile, ServedProfile
from xpl_cli.audit.rules.registry import builtin_entries, entries
from xpl_cli.audit.rules.verdict import PARITY, Verdict, VerdictStatus, verdict_of
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.phrases import join_limited
from xpl_cli.model_io import pairs
from xpl_cli.packages.package import POLICY

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_MUST = "must"
_SERVED_BY_MODEL = (None, Profile.FULL)
"""Profiles of gates in which the real model answered."""
_FAILING = (Outcome.NOT_RUN, Outcome.ERROR, Outcome.FAIL)
_SEVERITY_ORDER = (Outcome.NOT_APPLICABLE, Outcome.PASS, Outcome.WARN, *_FAILING)
_MOST_LISTED = 4


@dataclass(frozen=True)
class BundledAudit:
    """The audit report of the adapter in a bundle.

    Attributes:
        report: what follows from the rules' findings.
        claimed: verdict, statement, proven and unproven as the report claims them, as far as it does.
        mocks: name of each gate that ran without the real model, to what answered instead.
        variant: of the evaluated adapter; None for the policy itself.
    """

    report: TargetReport
    claimed: Mapping[str, Any]
    mocks: Mapping[str, str | None]
    variant: str | None

    @classmethod
    def parse(cls, target: Mapping[str, Any], variant: str | None) -> Self:
        """Return the content of an entry of `targets` in a valid report."""
        report = TargetReport(target["path"], target["name"], POLICY)
        for gate_entry in target["gates"]:
            profile = gate_entry.get("profile")
            served = None if profile is None else ServedProfile(Profile(profile))
            gate = GateReport(Gate(gate_entry["name"]), digest=gate_entry.get("digest"), served=served)
            gate.results += [_result(one) for one in gate_entry["results"]]
            report.gates.append(gate)
        claimed_values = {key: target[key] for key in ("verdict", "statement", "proven", "unproven") if key in target}
        unreal = [gate for gate in target["gates"] if gate.get("profile") not in _SERVED_BY_MODEL]
        return cls(report, claimed_values, {gate["name"]: gate.get("stood_in") for gate in unreal}, variant)

    def derive_verdict(self, adapter: Path) -> Verdict:
        """Return the verdict that follows from the rules' findings and the adapter, whatever the report claims.

        Args:
            adapter: folder of the adapter in the bundle.
        """
        around = package_circumstances(Source(adapter, self.variant), POLICY, self.report.path)
        return verdict_of(replace(self.report, circumstances=around))

    def problems(self, adapter: Path) -> Iterator[str]:
        """Yield why the report does not show that the adapter in the bundle is green."""
        report, verdict = self.report, self.derive_verdict(adapter)
        missing = [gate.value for gate in Gate if gate not in {entry.name for entry in report.gates}]
        if missing:
            yield f"the audit ran without the gates {', '.join(missing)}"
        if verdict.status in (VerdictStatus.RED, VerdictStatus.INCOMPLETE):
            open_rules = [f"{one.code} {one.outcome.value}" for one in report.results if one.outcome in _FAILING]
            failed_rules = join_limited(open_rules, _MOST_LISTED) or "nothing passed"
            yield f"the audit is not green: its rules make it {verdict.status} ({failed_rules})"
        yield from self._overstatements(verdict, adapter)
        for gate in report.gates:
            yield from _missing_rules(gate)
        yield from _static_gate_differences(report, adapter, self.variant)
        for name, stood_in in self.mocks.items():
            yield f"the audit's {name} gate ran without the real model: {stood_in}"

    def _overstatements(self, verdict: Verdict, adapter: Path) -> Iterator[str]:
        """Yield where the report claims something else than what follows."""
        made = verdict.as_json()
        if self.claimed["verdict"] != verdict.status:
            yield f"the audit claims {self.claimed['verdict']}, but its rules and the adapter give {verdict.status}"
        for claim in verdict.proven:
            if claim.claim is PARITY and claim.numbers.get("pairs") != (count := pairs.read(adapter).count):
                yield f"the audit compared {claim.numbers.get('pairs')} golden pairs, and the adapter has {count}"
        if self.claimed.get("proven") != made["proven"]:
            yield f"the audit claims other proofs: its rules and the adapter give {verdict}"
        if not str(self.claimed.get("statement")).startswith(f"{verdict.status.upper()} "):
            yield f"the audit claims another statement: its rules and the adapter give {verdict}"


def _result(entry_data: Mapping[str, Any]) -> RuleResult:
    """Return the result of a rule: counted findings make it fail, or warn, whatever it claims."""
    rule = next((entry.load() for entry in entries() if entry.code == entry_data["code"]), None)
    severity = entry_data["severity"] if rule is None else rule.severity
    outcome = Outcome(entry_data["outcome"])
    if entry_data["findings"]:
        outcome = Outcome.FAIL if severity == _MUST else max(outcome, Outcome.WARN, key=_SEVERITY_ORDER.index)
    return RuleResult(
        entry_data["code"],
        entry_data["slug"],
        entry_data["requirement"],
        severity,
        outcome,
        reason=entry_data.get("reason"),
        waived=tuple(Waived(Finding(str(one["message"])), str(one["reason"])) for one in entry_data.get("waived", ())),
        proof=None if entry_data["findings"] else entry_data.get("proof"),
    )


def _missing_rules(gate: GateReport) -> Iterator[str]:
    """Yield which rules of a gate the report leaves out, or names twice."""
    codes = [result.code for result in gate.results]
    builtin = [entry for entry in builtin_entries() if entry.target == POLICY and not entry.is_advice]
    here = [entry for entry in builtin if not (entry.closes or entry.needs_demonstrations) and entry.runs_in(gate.name)]
    expected = {entry.code for entry in here}
    if lacking := sorted(expected.difference(codes)):
        yield f"the audit's {gate.name} gate is without the rules {join_limited(lacking, _MOST_LISTED)}"
    if twice := sorted({code for code in codes if codes.count(code) > 1}):
        yield f"the audit's {gate.name} gate has two results of {join_limited(twice, _MOST_LISTED)}"


def _static_gate_differences(report: TargetReport, adapter: Path, variant: str | None) -> Iterator[str]:
    """Yield where the static gate differs for the adapter in the bundle."""
    from xpl_cli.audit.engine.engine import audit
    from xpl_cli.audit.rules.options import AuditOptions

    claimed_gate = next((gate for gate in report.gates if gate.name is Gate.STATIC), None)
    if claimed_gate is None:
        return
    installed = tuple(entry.code for entry in entries() if entry.source is not None)
    options = AuditOptions(gates=(Gate.STATIC,), ignore=installed, overrides={sdk.Deploy.VARIANT: variant})
    (here,) = audit(adapter, POLICY, options, display_path=report.path).gates
    if here.outcome != claimed_gate.outcome:
        yield (
            f"the audit's static gate ended with {claimed_gate.outcome}, but for the adapter in the bundle it ends "
            f"with {here.outcome}"
        )
    elif here.digest != claimed_gate.digest:
        yield (
            f"the audit is not of the adapter in the bundle: its static gate has the digest {claimed_gate.digest}, the "
            f"adapter's has {here.digest}"
        )
