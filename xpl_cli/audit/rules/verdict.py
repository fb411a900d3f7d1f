"""Verdicts: the status of an audit, what it proves, and what it does not prove and why.

`GREEN` is always followed by what is proven. A run that left something out has a status of its own, and so has an
unfinished package. `VerdictStatus` and `CLAIMS` are complete lists.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Self

from xpl_cli.audit.rules.gates import DEMONSTRATIONS, GATES
from xpl_cli.audit.rules.model import CLAMPED, SHARED, Outcome
from xpl_cli.basics.phrases import count_noun, join_limited
from xpl_cli.packages.package import ENV, POLICY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from xpl_cli.audit.rules.model import Circumstances, GateReport, Numbers, RuleResult, TargetReport

_MOST: Final = 3
"""Most codes and placeholders that are named; of more the number is given."""

_MOST_CLAMPED: Final = 0.5
"""Share of clamped commands above which a verdict names it: the robot then does not execute what the policy says."""

_NOTHING_WRONG: Final = "nothing wrong in what ran"


class VerdictStatus(StrEnum):
    """The status of an audit; docs/audit.md explains each. If several apply, the first one counts."""

    RED = "red"
    INCOMPLETE = "incomplete"
    OPEN = "open"
    SHADOW = "shadow"
    PARTIAL = "partial"
    GREEN = "green"


@dataclass(frozen=True)
class VerdictClaim:
    """Something that an audit can prove of a package.

    Attributes:
        name: its name in reports.
        subject: what is unproven without it.
        rule: code of the rule that proves it; empty for what all gates prove together.
        needs: codes of rules that must hold for that proof.
        details: yields the numbers of a proof in words.
    """

    name: str
    subject: str
    rule: str = ""
    needs: tuple[str, ...] = ()
    details: Callable[[Numbers], Iterable[str]] = lambda _: ()

    def describe(self, numbers: Numbers) -> str:
        """Return the claim with the numbers of its proof, as `parity (24 pairs; assumed: gripper, frame)`."""
        detail = "; ".join(self.details(numbers))
        return f"{self.name} ({detail})" if detail else self.name


def _parity_details(numbers: Numbers) -> Iterable[str]:
    """Yield the number of golden pairs, and the conventions without a source."""
    yield count_noun(numbers.get("pairs", 0), "pair")
    if not numbers.get("conventions", True):
        yield "no convention named"
    elif numbers.get("assumptions"):
        yield f"assumed: {', '.join(numbers['assumptions'])}"
    elif "assumed" in numbers:  # in reports of earlier versions
        yield (
            f"{count_noun(numbers['assumed'], 'convention')} assumed" if numbers["assumed"] else "no convention assumed"
        )
    if numbers.get("undetermined"):
        yield f"undetermined: {', '.join(numbers['undetermined'])}"
    if "margin" in numbers:
        yield "smallest margin: `{words}` would show at {times:g} x tolerance in {pairs} of {of} pairs".format(
            **numbers["margin"]
        )
    if "independent" in numbers:
        sources = join_limited(numbers["independent"], _MOST)
        twice = "one reading twice: reference.py was generated with the block"
        yield f"independent: {sources}" if sources else twice if numbers.get("generated") else "one reading twice"
    if numbers.get(SHARED):
        yield f"one mistake may be in both ({join_limited(numbers[SHARED], _MOST)})"


def _demonstration_details(numbers: Numbers) -> Iterable[str]:
    """Yield the number of demonstrations that the policy was compared with."""
    yield count_noun(numbers.get("episodes", 0), "episode")


CONTRACT: Final = VerdictClaim("contract", "contract")
PARITY: Final = VerdictClaim("parity", "conversions", rule="XPL260", needs=("XPL261",), details=_parity_details)
CHECKED: Final = VerdictClaim("all checks", "demonstrations")
CLAIMS: Final[Mapping[str, tuple[VerdictClaim, ...]]] = {
    POLICY: (CONTRACT, PARITY),
    ENV: (CONTRACT,),
    DEMONSTRATIONS: (CHECKED,),
}
"""The claims for each kind of package, in the order of reports."""

DEMONSTRATED: Final = VerdictClaim(
    "demonstrations", "conventions of training", rule="XPL270", needs=("XPL271",), details=_demonstration_details
)
"""Only for audits with demonstrations. It is in the statement, but not in the lists of the JSON report,
whose values are fixed."""

_INDEPENDENT_EVIDENCE: Final = {"XPL262": "kinematics of the authors' rows", DEMONSTRATED.rule: "demonstrations"}
"""Rules that compare conventions with evidence independent of the adapter and reference.py."""

_CLAIM_RULES: Final = frozenset(code for claim in (PARITY, DEMONSTRATED) for code in (claim.rule, *claim.needs))


@dataclass(frozen=True)
class ProvenClaim:
    """A claim that holds.

    Attributes:
        claim: the claim.
        numbers: the rule's proof.
    """

    claim: VerdictClaim
    numbers: Numbers = field(default_factory=dict)

    def __str__(self) -> str:
        """Return it in words."""
        return self.claim.describe(self.numbers)


@dataclass(frozen=True)
class UnprovenClaim:
    """A claim that was not proven.

    Attributes:
        claim: the claim.
        reason: why.
        is_reported: whether the statement names it; not if the options left it out, or the status implies it.
    """

    claim: VerdictClaim
    reason: str
    is_reported: bool = True

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.claim.subject} unproven ({self.reason})"


@dataclass(frozen=True)
class Verdict:
    """The verdict on one package.

    Attributes:
        status: the status.
        about: the reason of the status; for `GREEN` what is proven.
        proven, unproven: every claim of the kind of package is in one of them.
        waived: codes of the rules with waived findings, once per finding.
        extra: claims that need data which not every audit has, such as demonstrations, proven or not.
    """

    status: VerdictStatus
    about: str
    proven: tuple[ProvenClaim, ...] = ()
    unproven: tuple[UnprovenClaim, ...] = ()
    waived: tuple[str, ...] = ()
    extra: tuple[ProvenClaim | UnprovenClaim, ...] = ()

    def __str__(self) -> str:
        """Return it as people read it: `GREEN contract; conversions unproven (no reference.py)`."""
        return f"{self.status.upper()} {self.details}"

    @property
    def details(self) -> str:
        """The statement without the status."""
        parts = [self.about]
        if self.status is not VerdictStatus.GREEN:
            parts += map(str, (*self.proven, *(item for item in self.extra if isinstance(item, ProvenClaim))))
        if self.waived:
            parts.append(f"{count_noun(len(self.waived), 'finding')} waived ({_list_codes(self.waived)})")
        unproven = [*self.unproven, *(item for item in self.extra if isinstance(item, UnprovenClaim))]
        return "; ".join([*parts, *(str(item) for item in unproven if item.is_reported)])

    def as_json(self) -> dict[str, object]:
        """Return it as keys of a target in audit.schema.json."""
        return {
            "verdict": self.status.value,
            "statement": str(self),
            "proven": [{"word": item.claim.name, "numbers": dict(item.numbers)} for item in self.proven],
            "unproven": [{"word": item.claim.name, "reason": item.reason} for item in self.unproven],
        }


@dataclass(frozen=True)
class GateSummary:
    """The part of a gate's report that a verdict needs.

    Attributes:
        name: the gate's.
        outcome: how it ended.
        reason: why it was not started, or did not apply.
        stood_in: what replaced the model, in a few words; empty with the real model.
        failed, crashed, not_run: codes of the rules that ended so.
        waived: codes of the rules with waived findings, once per finding.
        proofs: the rules' proofs, by code.
        doubts: why rules of a claim do not prove it here, by code.
        shared: codes of rules with the same finding in the golden pairs as in the adapter.
        warned: codes of the rules that warned.
        clamped: largest share of the commands of a rollout that the environment clamped.
    """

    name: str
    outcome: Outcome
    reason: str | None = None
    stood_in: str = ""
    failed: tuple[str, ...] = ()
    crashed: tuple[str, ...] = ()
    not_run: tuple[str, ...] = ()
    waived: tuple[str, ...] = ()
    proofs: Mapping[str, Numbers] = field(default_factory=dict)
    doubts: Mapping[str, str] = field(default_factory=dict)
    shared: tuple[str, ...] = ()
    warned: tuple[str, ...] = ()
    clamped: float = 0.0

    @classmethod
    def of(cls, gate: GateReport) -> Self:
        """Return the summary of a gate's report."""
        by_harm = sorted(gate.results, key=lambda item: item.harm)
        of = {outcome: tuple(item.code for item in by_harm if item.outcome is outcome) for outcome in Outcome}
        unstarted_reason = next((item.reason for item in gate.results if item.reason), None)
        return cls(
            name=gate.name.value,
            outcome=gate.outcome,
            reason=gate.reason or (unstarted_reason if gate.outcome is Outcome.NOT_APPLICABLE else None),
            stood_in="" if gate.served is None else gate.served.short_note,
            failed=of[Outcome.FAIL],
            crashed=of[Outcome.ERROR],
            not_run=of[Outcome.NOT_RUN],
            waived=tuple(item.code for item in gate.results for _ in item.waived),
            proofs={item.code: dict(item.proof) for item in gate.results if item.proof is not None},
            warned=of[Outcome.WARN],
            clamped=max(
                (float((one.evidence or {}).get(CLAMPED, 0)) for item in gate.results for one in item.findings),
                default=0.0,
            ),
            shared=tuple(
                item.code for item in gate.results if any((one.evidence or {}).get(SHARED) for one in item.findings)
            ),
            doubts={
                item.code: doubt for item in gate.results if item.code in _CLAIM_RULES and (doubt := _doubt_of(item))
            },
        )


def verdict_of(report: TargetReport) -> Verdict:
    """Return the verdict on a package that was audited."""
    return judge(report.kind, [GateSummary.of(gate) for gate in report.gates], report.circumstances)


def judge(kind: str, gates: Sequence[GateSummary], circumstances: Circumstances) -> Verdict:
    """Return the verdict on a package.

    Args:
        kind: `policy` or `env`.
        gates: how its gates ended.
        circumstances: what else has to be known.
    """
    ran = [gate.name for gate in gates]
    if not circumstances.narrowed and len(ran) < len(GATES.get(kind, ())):
        circumstances = replace(circumstances, narrowed=f"{' and '.join(ran) or 'no gate'} only")
    status = _status_of(gates, circumstances)
    about = _describe_status(status, gates, circumstances)
    proven: list[ProvenClaim] = []
    unproven: list[UnprovenClaim] = []
    item: ProvenClaim | UnprovenClaim
    for claim in CLAIMS[kind]:
        if not claim.rule:
            item = (
                ProvenClaim(claim) if status is VerdictStatus.GREEN else UnprovenClaim(claim, about, is_reported=False)
            )
        else:
            item = _claim_of_rule(claim, gates, circumstances)
        proven += [item] if isinstance(item, ProvenClaim) else []
        unproven += [item] if isinstance(item, UnprovenClaim) else []
    extra = tuple(_demonstration_claims(gates, circumstances)) if kind == POLICY else ()
    if status is VerdictStatus.GREEN:
        proven_items = [*proven, *(item for item in extra if isinstance(item, ProvenClaim))]
        about = ", ".join([*map(str, proven_items), *_limits_of_contract(gates, circumstances)])
    elif status not in (VerdictStatus.RED, VerdictStatus.INCOMPLETE):
        about = f"{about}: {_NOTHING_WRONG}"
    waived = tuple(code for gate in gates for code in gate.waived)
    return Verdict(status, about, tuple(proven), tuple(unproven), waived, extra)


def weakest(statuses: Iterable[VerdictStatus]) -> VerdictStatus:
    """Return the lowest of several statuses; green for none."""
    return min(statuses, key=list(VerdictStatus).index, default=VerdictStatus.GREEN)


def _status_of(gates: Sequence[GateSummary], circumstances: Circumstances) -> VerdictStatus:
    outcomes = {gate.outcome for gate in gates}
    if outcomes & {Outcome.FAIL, Outcome.ERROR}:
        return VerdictStatus.RED
    if Outcome.PASS not in outcomes or not outcomes <= {Outcome.PASS, Outcome.NOT_APPLICABLE}:
        return VerdictStatus.INCOMPLETE
    if circumstances.placeholders or circumstances.unknown:
        return VerdictStatus.OPEN
    if any(gate.stood_in for gate in gates):
        return VerdictStatus.SHADOW
    return VerdictStatus.PARTIAL if circumstances.narrowed else VerdictStatus.GREEN


def _describe_status(status: VerdictStatus, gates: Sequence[GateSummary], circumstances: Circumstances) -> str:
    """Return the reason of a status other than green."""
    if status in (VerdictStatus.RED, VerdictStatus.INCOMPLETE):
        counts = [
            _count_codes([code for gate in gates for code in gate.failed], "failed"),
            _count_codes([code for gate in gates for code in gate.crashed], "crashed"),
            _count_codes([code for gate in gates if gate.reason is None for code in gate.not_run], "could not run"),
        ]
        with_weights = f"with {circumstances.weights}" if circumstances.weights and any(counts) else ""
        return ", ".join(filter(None, [*counts, with_weights])) or _gate_reasons(gates)
    caveats = [
        _count_places(circumstances.placeholders, "place", "to fill in"),
        _count_places(circumstances.unknown, "model_io value", "unknown"),
        ", ".join(dict.fromkeys(gate.stood_in for gate in gates if gate.stood_in)),
        circumstances.narrowed,
        *_conditions(gates, circumstances),
    ]
    return ", ".join(filter(None, caveats))


def _gate_reasons(gates: Sequence[GateSummary]) -> str:
    """Return why gates did not start."""
    reasons = dict.fromkeys(f"{gate.name}: {gate.reason}" for gate in gates if gate.reason)
    return "; ".join(reasons) or "nothing was checked"


def _limits_of_contract(gates: Sequence[GateSummary], circumstances: Circumstances) -> Iterable[str]:
    """Yield what limits the proof of the contract."""
    for gate in gates:
        if gate.outcome is Outcome.NOT_APPLICABLE:
            yield f"not in the {gate.name} gate ({gate.reason or 'no rule of it applies'})"
    if circumstances.assumed and circumstances.without_pairs is not None:
        yield f"{count_noun(len(circumstances.assumed), 'value')} assumed ({', '.join(circumstances.assumed)})"
    yield from _conditions(gates, circumstances)
    if circumstances.settings:
        yield f"with --set {join_limited(circumstances.settings, _MOST)}"


def _conditions(gates: Sequence[GateSummary], circumstances: Circumstances) -> Iterable[str]:
    """Yield under which conditions nothing was wrong: the weights, most commands clamped, warnings."""
    if circumstances.weights:
        yield circumstances.weights
    clamped = max((gate.clamped for gate in gates), default=0.0)
    if clamped > _MOST_CLAMPED:
        yield f"{clamped:.0%} of the commands clamped"
    if warned := [code for gate in gates for code in gate.warned]:
        yield _count_codes(warned, "warned")


def _demonstration_claims(
    gates: Sequence[GateSummary], circumstances: Circumstances
) -> Iterable[ProvenClaim | UnprovenClaim]:
    """Yield the claim of demonstrations, if there are any."""
    codes = {DEMONSTRATED.rule, *DEMONSTRATED.needs}
    if any(codes & {*gate.proofs, *gate.doubts} for gate in gates):
        yield _claim_of_rule(DEMONSTRATED, gates, circumstances)


def _claim_of_rule(
    claim: VerdictClaim, gates: Sequence[GateSummary], circumstances: Circumstances
) -> ProvenClaim | UnprovenClaim:
    """Return a claim as proven by its rule; a single doubt makes it unproven."""
    doubts = [gate.doubts[code] for code in (*claim.needs, claim.rule) for gate in gates if code in gate.doubts]
    proofs = [(gate, gate.proofs[claim.rule]) for gate in gates if claim.rule in gate.proofs]
    is_reported = bool(not circumstances.narrowed or doubts or proofs)
    if claim is PARITY and circumstances.without_pairs is not None:
        return UnprovenClaim(claim, circumstances.without_pairs, is_reported)
    if doubts or not proofs:
        return UnprovenClaim(claim, doubts[0] if doubts else f"{claim.rule} proved nothing", is_reported)
    stand_ins = [gate.stood_in for gate, _ in proofs if gate.stood_in]
    if stand_ins:
        return UnprovenClaim(claim, stand_ins[0])
    return ProvenClaim(claim, {**proofs[0][1], **_parity_evidence(gates)} if claim is PARITY else proofs[0][1])


def _parity_evidence(gates: Sequence[GateSummary]) -> Numbers:
    """Return further evidence for conventions: adapter and reference.py may share one author's mistake."""
    proofs = {code for gate in gates for code in gate.proofs}
    shared = [code for gate in gates for code in gate.shared]
    evidence: dict[str, object] = {
        "independent": [word for code, word in _INDEPENDENT_EVIDENCE.items() if code in proofs]
    }
    return {**evidence, SHARED: shared} if shared else evidence


def _doubt_of(result: RuleResult) -> str | None:
    """Return why a rule does not prove its claim; None if it does, or if it only has to hold and does."""
    if result.waived:
        return f"findings of {result.code} are waived"
    if result.findings:
        return f"{result.code} found {count_noun(len(result.findings), 'difference')}"
    return None if result.outcome is Outcome.PASS else result.brief or result.reason


def _count_places(entries: Sequence[str], noun: str, what: str) -> str:
    return f"{count_noun(len(entries), noun)} {what} ({join_limited(entries, 1)})" if entries else ""


def _count_codes(codes: Sequence[str], what: str) -> str:
    return f"{count_noun(len(codes), 'rule')} {what} ({_list_codes(codes)})" if codes else ""


def _list_codes(codes: Sequence[str]) -> str:
    """Return codes as text, each once, however often it occurs."""
    return join_limited(list(Counter(codes)), _MOST)
