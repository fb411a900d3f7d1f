"""What the audit report of a bundle comes to: its verdict is made again from what its rules found, and never read.

The report is a file that whoever made the bundle could write. Its outcomes are held against its own findings, its rules
against those that there are, and its static gate, which runs nothing of an adapter, against the adapter in the bundle.
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
from xpl_cli.audit.rules.verdict import PARITY, Verdict, Word, judged
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.words import listed
from xpl_cli.model_io import pairs
from xpl_cli.packages.package import POLICY

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_MUST = "must"
_SERVED_BY_MODEL = (None, Profile.FULL)
"""Profiles of gates that no stand-in answered in."""
_AGAINST = (Outcome.NOT_RUN, Outcome.ERROR, Outcome.FAIL)
_GRAVITY = (Outcome.NOT_APPLICABLE, Outcome.PASS, Outcome.WARN, *_AGAINST)
_SHOWN = 4


@dataclass(frozen=True)
class BundledAudit:
    """What the audit report of a bundle says of its adapter.

    Attributes:
        report: what follows from what the rules found.
        said: what the report says that this comes to: verdict, statement, proven, unproven, as far as it says so.
        stood_in: by the name of each gate that ran without the real model, what stood in for it.
        variant: of the adapter that was evaluated; None for the policy itself.
    """

    report: TargetReport
    claimed: Mapping[str, Any]
    mocks: Mapping[str, str | None]
    variant: str | None

    @classmethod
    def parse(cls, target: Mapping[str, Any], variant: str | None) -> Self:
        """Return what an entry of `targets` in a valid report says."""
        report = TargetReport(target["path"], target["name"], POLICY)
        for told in target["gates"]:
            profile = told.get("profile")
            served = None if profile is None else ServedProfile(Profile(profile))
            gate = GateReport(Gate(told["name"]), digest=told.get("digest"), served=served)
            gate.results += [_result(one) for one in told["results"]]
            report.gates.append(gate)
        said = {key: target[key] for key in ("verdict", "statement", "proven", "unproven") if key in target}
        unreal = [gate for gate in target["gates"] if gate.get("profile") not in _SERVED_BY_MODEL]
        return cls(report, said, {gate["name"]: gate.get("stood_in") for gate in unreal}, variant)

    def derive_verdict(self, adapter: Path) -> Verdict:
        """Return the verdict that follows from what rules found and from the adapter, whatever the report says.

        Args:
            adapter: folder of the adapter in the bundle.
        """
        around = package_circumstances(Source(adapter, self.variant), POLICY, self.report.path)
        return judged(replace(self.report, circumstances=around))

    def problems(self, adapter: Path) -> Iterator[str]:
        """Yield why the report does not show that the adapter in a folder of the bundle is green."""
        report, verdict = self.report, self.derive_verdict(adapter)
        missing = [gate.value for gate in Gate if gate not in {entry.name for entry in report.gates}]
        if missing:
            yield f"the audit ran without the gates {', '.join(missing)}"
        if verdict.word in (Word.RED, Word.INCOMPLETE):
            open_rules = [f"{one.code} {one.outcome.value}" for one in report.results if one.outcome in _AGAINST]
            found = listed(open_rules, _SHOWN) or "nothing passed"
            yield f"the audit is not green: its rules make it {verdict.word} ({found})"
        yield from self._overstated(verdict, adapter)
        for gate in report.gates:
            yield from _incomplete(gate)
        yield from _unbound(report, adapter, self.variant)
        for name, stood_in in self.mocks.items():
            yield f"the audit's {name} gate ran without the real model: {stood_in}"

    def _overstated(self, verdict: Verdict, adapter: Path) -> Iterator[str]:
        """Yield where the report says something else than what follows."""
        made = verdict.as_json()
        if self.claimed["verdict"] != verdict.word:
            yield (
                f"the audit says that it is {self.claimed['verdict']}, its rules and the adapter make it {verdict.word}"
            )
        for claim in verdict.proven:
            if claim.claim is PARITY and claim.numbers.get("pairs") != (count := pairs.read(adapter).count):
                yield f"the audit compared {claim.numbers.get('pairs')} golden pairs, and the adapter has {count}"
        if self.claimed.get("proven") != made["proven"]:
            yield f"the audit says otherwise what is proven: its rules and the adapter make it {verdict}"
        if not str(self.claimed.get("statement")).startswith(f"{verdict.word.upper()} "):
            yield f"the audit says otherwise what it comes to: its rules and the adapter make it {verdict}"


def _result(told: Mapping[str, Any]) -> RuleResult:
    """Return the result of a rule: findings that count make it fail, or warn, whatever it says of itself."""
    rule = next((entry.load() for entry in entries() if entry.code == told["code"]), None)
    severity = told["severity"] if rule is None else rule.severity
    outcome = Outcome(told["outcome"])
    if told["findings"]:
        outcome = Outcome.FAIL if severity == _MUST else max(outcome, Outcome.WARN, key=_GRAVITY.index)
    return RuleResult(
        told["code"],
        told["slug"],
        told["requirement"],
        severity,
        outcome,
        reason=told.get("reason"),
        waived=tuple(Waived(Finding(str(one["message"])), str(one["reason"])) for one in told.get("waived", ())),
        proof=None if told["findings"] else told.get("proof"),
    )


def _incomplete(gate: GateReport) -> Iterator[str]:
    """Yield which rules of a gate the report leaves out, or names twice."""
    told = [result.code for result in gate.results]
    known = [entry for entry in builtin_entries() if entry.target == POLICY and not entry.is_advice]
    here = [entry for entry in known if not (entry.closes or entry.needs_demonstrations) and entry.runs_in(gate.name)]
    wanted = {entry.code for entry in here}
    if lacking := sorted(wanted.difference(told)):
        yield f"the audit's {gate.name} gate is without the rules {listed(lacking, _SHOWN)}"
    if twice := sorted({code for code in told if told.count(code) > 1}):
        yield f"the audit's {gate.name} gate has two results of {listed(twice, _SHOWN)}"


def _unbound(report: TargetReport, adapter: Path, variant: str | None) -> Iterator[str]:
    """Yield where the static gate says something else of the adapter in the bundle."""
    from xpl_cli.audit.engine.engine import audit
    from xpl_cli.audit.rules.options import AuditOptions

    told = next((gate for gate in report.gates if gate.name is Gate.STATIC), None)
    if told is None:
        return
    installed = tuple(entry.code for entry in entries() if entry.source is not None)
    options = AuditOptions(gates=(Gate.STATIC,), ignore=installed, overrides={sdk.Deploy.VARIANT: variant})
    (here,) = audit(adapter, POLICY, options, shown=report.path).gates
    if here.outcome != told.outcome:
        yield f"the audit's static gate ended with {told.outcome}; of the adapter in the bundle it says {here.outcome}"
    elif here.digest != told.digest:
        yield (
            f"the audit is not of the adapter in the bundle: its static gate has the digest {told.digest}, and the "
            f"adapter's is {here.digest}"
        )
