"""What a verdict says: one word for what an audit comes to, what it proves, and what it does not and why.

`GREEN` is never said alone: what is proven stands behind it. A run that looked at less than everything has a word of
its own, and so has a package that is not finished. `Word` and `CLAIMS` are all there is.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Self

from xpl_cli.audit.rules.gates import DEMONSTRATIONS, GATES
from xpl_cli.audit.rules.model import SHARED, Outcome
from xpl_cli.basics.words import amount, listed
from xpl_cli.packages.package import ENV, POLICY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from xpl_cli.audit.rules.model import Circumstances, GateReport, Numbers, Result, TargetReport

_MOST: Final = 3
"""Codes and places that are named; of more their number is told."""

_NOTHING_WRONG: Final = "nothing wrong in what ran"


class Word(StrEnum):
    """What an audit comes to; docs/audit.md says what each word means. Where several apply, the first one is said."""

    RED = "red"
    INCOMPLETE = "incomplete"
    OPEN = "open"
    SHADOW = "shadow"
    PARTIAL = "partial"
    GREEN = "green"


@dataclass(frozen=True)
class Claim:
    """Something that an audit can prove of a package.

    Attributes:
        word: how reports call it.
        subject: what is unproven without it.
        rule: code of the rule whose proof it is; empty for what all gates prove together.
        needs: codes of rules without which that proof is of something else.
        details: what of the numbers of a proof is told, in words.
    """

    word: str
    subject: str
    rule: str = ""
    needs: tuple[str, ...] = ()
    details: Callable[[Numbers], Iterable[str]] = lambda _: ()

    def told(self, numbers: Numbers) -> str:
        """Return the claim with the numbers of its proof, as `parity (24 pairs; assumed: gripper, frame)`."""
        detail = "; ".join(self.details(numbers))
        return f"{self.word} ({detail})" if detail else self.word


def _of_parity(numbers: Numbers) -> Iterable[str]:
    """Yield the pairs that were compared, and the conventions that nobody was found to say."""
    yield amount(numbers.get("pairs", 0), "pair")
    if not numbers.get("conventions", True):
        yield "no convention named"
    elif numbers.get("assumptions"):
        yield f"assumed: {', '.join(numbers['assumptions'])}"
    elif "assumed" in numbers:  # as reports of earlier versions have it
        yield f"{amount(numbers['assumed'], 'convention')} assumed" if numbers["assumed"] else "no convention assumed"
    if numbers.get("undetermined"):
        yield f"undetermined: {', '.join(numbers['undetermined'])}"
    if "margin" in numbers:
        yield "smallest margin: `{words}` would show at {times:g} x tolerance in {pairs} of {of} pairs".format(
            **numbers["margin"]
        )
    if "independent" in numbers:
        told = listed(numbers["independent"], _MOST)
        yield f"independent: {told}" if told else "one reading twice"
    if numbers.get(SHARED):
        yield f"one mistake may be in both ({listed(numbers[SHARED], _MOST)})"


def _of_demonstrations(numbers: Numbers) -> Iterable[str]:
    """Yield the episodes that the policy was held against."""
    yield amount(numbers.get("episodes", 0), "episode")


CONTRACT: Final = Claim("contract", "contract")
PARITY: Final = Claim("parity", "conversions", rule="XPL260", needs=("XPL261",), details=_of_parity)
CHECKED: Final = Claim("all checks", "demonstrations")
CLAIMS: Final[Mapping[str, tuple[Claim, ...]]] = {
    POLICY: (CONTRACT, PARITY),
    ENV: (CONTRACT,),
    DEMONSTRATIONS: (CHECKED,),
}
"""What can be proven of each kind of package, in the order in which it is told."""

FOLLOWED: Final = Claim(
    "demonstrations", "conventions of training", rule="XPL270", needs=("XPL271",), details=_of_demonstrations
)
"""What is told only of who gave demonstrations. It stands in the statement; lists in reports,
whose words are frozen, lack it."""

_WITNESSES: Final = {"XPL262": "kinematics of the authors' rows", FOLLOWED.rule: "demonstrations"}
"""Rules that hold conventions against something that neither the adapter nor reference.py was written from."""

_OF_RULES: Final = frozenset(code for claim in (PARITY, FOLLOWED) for code in (claim.rule, *claim.needs))


@dataclass(frozen=True)
class Proven:
    """A claim that holds.

    Attributes:
        claim: the claim.
        numbers: what the rule said that it proved.
    """

    claim: Claim
    numbers: Numbers = field(default_factory=dict)

    def __str__(self) -> str:
        """Return it in words."""
        return self.claim.told(self.numbers)


@dataclass(frozen=True)
class Unproven:
    """A claim that was not shown to hold.

    Attributes:
        claim: the claim.
        reason: why.
        is_told: whether a verdict names it; one that nobody asked for, or that the word tells, is not.
    """

    claim: Claim
    reason: str
    is_told: bool = True

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.claim.subject} unproven ({self.reason})"


@dataclass(frozen=True)
class Verdict:
    """What an audit of one package comes to.

    Attributes:
        word: in a word.
        about: what the word is about; for `GREEN` what is proven.
        proven, unproven: every claim of the kind of package is in one of them.
        waived: codes of the rules with findings that the manifest accepts, each as often as it has some.
        beside: what else was held against something that not every audit is given, proven or not.
    """

    word: Word
    about: str
    proven: tuple[Proven, ...] = ()
    unproven: tuple[Unproven, ...] = ()
    waived: tuple[str, ...] = ()
    beside: tuple[Proven | Unproven, ...] = ()

    def __str__(self) -> str:
        """Return it as people read it: `GREEN contract; conversions unproven (no reference.py)`."""
        return f"{self.word.upper()} {self.said}"

    @property
    def said(self) -> str:
        """What stands behind the word."""
        parts = [self.about]
        if self.word is not Word.GREEN:
            parts += map(str, (*self.proven, *(item for item in self.beside if isinstance(item, Proven))))
        if self.waived:
            parts.append(f"{amount(len(self.waived), 'finding')} waived ({_named(self.waived)})")
        unproven = [*self.unproven, *(item for item in self.beside if isinstance(item, Unproven))]
        return "; ".join([*parts, *(str(item) for item in unproven if item.is_told)])

    def as_json(self) -> dict[str, object]:
        """Return it as keys of a target in audit.schema.json."""
        return {
            "verdict": self.word.value,
            "statement": str(self),
            "proven": [{"word": item.claim.word, "numbers": dict(item.numbers)} for item in self.proven],
            "unproven": [{"word": item.claim.word, "reason": item.reason} for item in self.unproven],
        }


@dataclass(frozen=True)
class Ended:
    """What a verdict has to know of one gate.

    Attributes:
        name: the gate's.
        outcome: how it ended.
        reason: why it was not started, or had nothing to prove.
        stood_in: what stood in for the model, in a few words; empty if everything was real.
        failed, crashed, not_run: codes of the rules that ended so.
        waived: codes of rules with findings that were accepted, each as often as it has some.
        proofs: what rules said that they proved, by code.
        doubts: why rules that prove a claim prove none here, by code.
        shared: codes of rules that found in the golden pairs what they found in the adapter.
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

    @classmethod
    def of(cls, gate: GateReport) -> Self:
        """Return what is to be known of a gate that was carried out, or that waits for another one."""
        of = {outcome: tuple(item.code for item in gate.results if item.outcome is outcome) for outcome in Outcome}
        silent = next((item.reason for item in gate.results if item.reason), None)
        return cls(
            name=gate.name.value,
            outcome=gate.outcome,
            reason=gate.reason or (silent if gate.outcome is Outcome.NOT_APPLICABLE else None),
            stood_in="" if gate.served is None else gate.served.briefly,
            failed=of[Outcome.FAIL],
            crashed=of[Outcome.ERROR],
            not_run=of[Outcome.NOT_RUN],
            waived=tuple(item.code for item in gate.results for _ in item.waived),
            proofs={item.code: dict(item.proof) for item in gate.results if item.proof is not None},
            shared=tuple(
                item.code for item in gate.results if any((one.evidence or {}).get(SHARED) for one in item.findings)
            ),
            doubts={item.code: doubt for item in gate.results if item.code in _OF_RULES and (doubt := _doubt(item))},
        )


def judged(report: TargetReport) -> Verdict:
    """Return the verdict on a package that was audited."""
    return judge(report.kind, [Ended.of(gate) for gate in report.gates], report.circumstances)


def judge(kind: str, gates: Sequence[Ended], around: Circumstances) -> Verdict:
    """Return the verdict on a package.

    Args:
        kind: `policy` or `env`.
        gates: how its gates ended.
        around: what else has to be known.
    """
    ran = [gate.name for gate in gates]
    if not around.narrowed and len(ran) < len(GATES.get(kind, ())):
        around = replace(around, narrowed=f"{' and '.join(ran) or 'no gate'} only")
    word = _word(gates, around)
    about = _about(word, gates, around)
    proven: list[Proven] = []
    unproven: list[Unproven] = []
    found: Proven | Unproven
    for claim in CLAIMS[kind]:
        if not claim.rule:
            found = Proven(claim) if word is Word.GREEN else Unproven(claim, about, is_told=False)
        else:
            found = _by_rule(claim, gates, around)
        proven += [found] if isinstance(found, Proven) else []
        unproven += [found] if isinstance(found, Unproven) else []
    beside = tuple(_beside(gates, around)) if kind == POLICY else ()
    if word is Word.GREEN:
        held = [*proven, *(item for item in beside if isinstance(item, Proven))]
        about = ", ".join([*map(str, held), *_asides(gates, around)])
    elif word not in (Word.RED, Word.INCOMPLETE):
        about = f"{about}: {_NOTHING_WRONG}"
    waived = tuple(code for gate in gates for code in gate.waived)
    return Verdict(word, about, tuple(proven), tuple(unproven), waived, beside)


def weakest(words: Iterable[Word]) -> Word:
    """Return the word for several packages: that of the one of which least can be said; green for none."""
    return min(words, key=list(Word).index, default=Word.GREEN)


def _word(gates: Sequence[Ended], around: Circumstances) -> Word:
    outcomes = {gate.outcome for gate in gates}
    if outcomes & {Outcome.FAIL, Outcome.ERROR}:
        return Word.RED
    if Outcome.PASS not in outcomes or not outcomes <= {Outcome.PASS, Outcome.NOT_APPLICABLE}:
        return Word.INCOMPLETE
    if around.places or around.unknown:
        return Word.OPEN
    if any(gate.stood_in for gate in gates):
        return Word.SHADOW
    return Word.PARTIAL if around.narrowed else Word.GREEN


def _about(word: Word, gates: Sequence[Ended], around: Circumstances) -> str:
    """Return what a word is about, but for green."""
    if word in (Word.RED, Word.INCOMPLETE):
        told = [
            _counted([code for gate in gates for code in gate.failed], "failed"),
            _counted([code for gate in gates for code in gate.crashed], "crashed"),
            _counted([code for gate in gates if gate.reason is None for code in gate.not_run], "could not run"),
        ]
        return ", ".join(filter(None, told)) or _silent(gates)
    caveats = [
        _places(around.places, "place", "to fill in"),
        _places(around.unknown, "model_io value", "unknown"),
        ", ".join(dict.fromkeys(gate.stood_in for gate in gates if gate.stood_in)),
        around.narrowed,
    ]
    return ", ".join(filter(None, caveats))


def _silent(gates: Sequence[Ended]) -> str:
    """Return why gates came to nothing of which no rule tells."""
    reasons = dict.fromkeys(f"{gate.name}: {gate.reason}" for gate in gates if gate.reason)
    return "; ".join(reasons) or "nothing was checked"


def _asides(gates: Sequence[Ended], around: Circumstances) -> Iterable[str]:
    """Yield how far the contract was tried, where that is less than usual."""
    for gate in gates:
        if gate.outcome is Outcome.NOT_APPLICABLE:
            yield f"not in the {gate.name} gate ({gate.reason or 'no rule of it applies'})"
    if around.assumed and around.without_pairs is not None:
        yield f"{amount(len(around.assumed), 'value')} assumed ({', '.join(around.assumed)})"
    if around.settings:
        yield f"with --set {listed(around.settings, _MOST)}"


def _beside(gates: Sequence[Ended], around: Circumstances) -> Iterable[Proven | Unproven]:
    """Yield what follows from demonstrations, where there were some."""
    codes = {FOLLOWED.rule, *FOLLOWED.needs}
    if any(codes & {*gate.proofs, *gate.doubts} for gate in gates):
        yield _by_rule(FOLLOWED, gates, around)


def _by_rule(claim: Claim, gates: Sequence[Ended], around: Circumstances) -> Proven | Unproven:
    """Return whether the rule of a claim has proved it; one doubt, wherever it comes from, is enough against it."""
    doubts = [gate.doubts[code] for code in (*claim.needs, claim.rule) for gate in gates if code in gate.doubts]
    proofs = [(gate, gate.proofs[claim.rule]) for gate in gates if claim.rule in gate.proofs]
    is_asked = bool(not around.narrowed or doubts or proofs)
    if claim is PARITY and around.without_pairs is not None:
        return Unproven(claim, around.without_pairs, is_asked)
    if doubts or not proofs:
        return Unproven(claim, doubts[0] if doubts else f"{claim.rule} proved nothing", is_asked)
    stand_ins = [gate.stood_in for gate, _ in proofs if gate.stood_in]
    if stand_ins:
        return Unproven(claim, stand_ins[0])
    return Proven(claim, {**proofs[0][1], **_around_parity(gates)} if claim is PARITY else proofs[0][1])


def _around_parity(gates: Sequence[Ended]) -> Numbers:
    """Return what else is known of conventions that adapter and reference.py agree on: one author may err twice."""
    proofs = {code for gate in gates for code in gate.proofs}
    shared = [code for gate in gates for code in gate.shared]
    found: dict[str, object] = {"independent": [word for code, word in _WITNESSES.items() if code in proofs]}
    return {**found, SHARED: shared} if shared else found


def _doubt(result: Result) -> str | None:
    """Return why a rule that would prove something does not; None if it does, or if it only has to hold, and does."""
    if result.waived:
        return f"findings of {result.code} are waived"
    if result.findings:
        return f"{result.code} found {amount(len(result.findings), 'difference')}"
    return None if result.outcome is Outcome.PASS else result.reason


def _places(found: Sequence[str], noun: str, what: str) -> str:
    return f"{amount(len(found), noun)} {what} ({listed(found, 1)})" if found else ""


def _counted(codes: Sequence[str], what: str) -> str:
    return f"{amount(len(codes), 'rule')} {what} ({_named(codes)})" if codes else ""


def _named(codes: Sequence[str]) -> str:
    """Return codes, each once; those that come most often are not told from others."""
    return listed(list(Counter(codes)), _MOST)
