"""Findings, results of rules, and reports of gates and targets."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, TypedDict

from xpl_cli.audit.rules.harm import Harm
from xpl_cli.basics.errors import ExitCode
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.audit.rules.gates import DataGate, Gate
    from xpl_cli.audit.rules.measurements import SuccessMeasurement
    from xpl_cli.audit.rules.profiles import Profile, ServedProfile

Numbers = Mapping[str, Any]
"""Evidence or proof: JSON values by name."""
SHARED: Final = "shared"
"""Key of evidence: whether the golden pairs have the same finding, so that both may have one mistake."""
CLAMPED: Final = "clamped"
"""Key of evidence: share of the commands of a rollout that the environment clamped."""
TRACEBACK: Final = "traceback"
"""What located a finding: the innermost line of the package's own files in the traceback of the adapter's error."""
HANDLER: Final = "handler"
"""What located a finding: nothing was raised, and the line is that of the method which answered."""
_NUMBER = re.compile(r"[-+]?\b\d+(\.\d+)?(e[-+]?\d+)?")


class Outcome(StrEnum):
    """How a rule ended. `not_run` is never green; `error` means that the rule itself crashed."""

    PASS = "pass"  # noqa: S105 - an outcome
    FAIL = "fail"
    WARN = "warn"
    NOT_APPLICABLE = "not_applicable"
    NOT_RUN = "not_run"
    ERROR = "error"


class NotApplicable(Exception):  # noqa: N818 - an outcome, not an error
    """Raised by a rule that does not apply to this target; the argument says why."""


class NotRun(Exception):  # noqa: N818 - an outcome, not an error
    """Raised by a rule that cannot run, or a fact that is not available.

    Args:
        reason: why, in full.
        brief: why, in a few words without paths; the reason itself by default.
        advice: what the user can do about it, in sentences without full stops.
        lacks: kinds of what the machine lacks, such as `module` and `checkpoint`.
    """

    def __init__(
        self, reason: str = "", *, brief: str = "", advice: tuple[str, ...] = (), lacks: tuple[str, ...] = ()
    ) -> None:
        super().__init__(reason)
        self.brief = brief
        self.advice = advice
        self.lacks = lacks


@dataclass(frozen=True)
class Edit:
    """A range of a file and its replacement.

    Args:
        path: file, relative to the adapter's folder.
        line, column: its start; 1-based, columns counted in characters.
        end_line, end_column: the first character after it; equal to the start if the edit only inserts.
        text: the replacement; empty to delete.
    """

    path: str
    line: int
    column: int
    end_line: int
    end_column: int
    text: str


@dataclass(frozen=True)
class Fix:
    """What to do about a finding.

    Args:
        kind: `command` (text is an exact command), `safe_edit` (correct behaviour does not change), `unsafe_edit`,
            or `advice` (text is a sentence).
        text: the command, the edit in short, or the advice.
        edits: the edits for `--fix`; they do not overlap. Without any, the author has to do it.
    """

    kind: str
    text: str
    edits: tuple[Edit, ...] = ()


class Location(TypedDict, total=False):
    """Where a `Finding` is: file, and 1-based lines and columns counted in characters."""

    path: str
    line: int
    column: int
    end_line: int
    end_column: int


@dataclass(frozen=True)
class Finding:
    """One violation of a rule.

    Args:
        message: the consequence in one sentence.
        path: file, relative to the adapter's folder, or None if it is in no file.
        line, column, end_line, end_column: 1-based range in that file, columns in characters; the end column is the
            first one after it.
        expected: what was expected.
        got: what was found.
        evidence: frames and numbers that show it; JSON values.
        fix: what to do.
        must: whether it fails. None: by the level of the rule's requirement. True: although that is a SHOULD. False: it
            only warns although that is a MUST, since it is not certain; the message then says why.
        located_by: what the line is, if the rule itself did not say one: `TRACEBACK` or `HANDLER`.
    """

    message: str
    path: str | None = None
    line: int | None = None
    column: int | None = None
    end_line: int | None = None
    end_column: int | None = None
    expected: str | None = None
    got: str | None = None
    evidence: Numbers | None = None
    fix: Fix | None = None
    must: bool | None = None
    located_by: str | None = None

    def fingerprint(self, code: str, path: str | None = None, occurrence: int = 1) -> str:
        """Return an identity that survives edits elsewhere in the file: rule, file and message without numbers.

        Args:
            code: the rule's.
            path: file, relative to the repository.
            occurrence: how many findings of this rule and message the file has up to this one, itself included.
        """
        text = "\0".join((code, path or self.path or "", _NUMBER.sub("#", self.message)))
        if occurrence > 1:
            text += f"\0{occurrence}"
        return hashlib.sha256(text.encode(errors="replace")).hexdigest()[:16]


@dataclass(frozen=True)
class Proof:
    """What a rule proved, in numbers; a rule may yield one besides its findings.

    Args:
        numbers: by name, JSON values; what a verdict may print.
    """

    numbers: Numbers


@dataclass(frozen=True)
class Waived:
    """A finding that the adapter's manifest declares accepted, and why."""

    finding: Finding
    reason: str


@dataclass(frozen=True)
class RuleResult:
    """The result of one rule on one target.

    Attributes:
        code, slug, requirement, severity: the rule's.
        findings: violations that count.
        reason: why the rule did not apply or run, or how it crashed.
        brief: the root of that reason in a few words, if it is shorter; rules with one root share it.
        advice: what the user can do so that the rule runs.
        lacks: kinds of what the machine lacks so that it could not run, such as `module`.
        tries: what the rule tries, as a noun phrase; empty for what its requirement is about.
        waived: accepted violations; they change no outcome.
        proof: what was proved, in numbers; None with findings, or if the rule yields none.
    """

    code: str
    slug: str
    requirement: str
    severity: str
    outcome: Outcome
    findings: tuple[Finding, ...] = ()
    reason: str | None = None
    waived: tuple[Waived, ...] = ()
    proof: Numbers | None = None
    brief: str = ""
    advice: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()
    tries: str = ""

    @property
    def harm(self) -> Harm:
        """What a package does that the rule finds."""
        return Harm.of(self.requirement)

    @property
    def subject(self) -> str:
        """What the rule tries, as a noun phrase."""
        requirement = spec.requirements().get(self.requirement)
        return self.tries or ("" if requirement is None else requirement.area)

    @property
    def explain(self) -> str:
        """The command that explains the rule."""
        return f"xpl explain {self.code}"


@dataclass
class GateReport:
    """One gate on one target.

    Attributes:
        finish: the deterministic finish line, if the gate ran.
        digest: hash of the adapter's behaviour; equal for equal behaviour under an equal fingerprint.
        served: the profile, if the gate served the adapter.
        figures: success rates and scores that were measured.
        source: hash of the package's files as the gate read them; None if it was not started.
    """

    name: Gate | DataGate
    results: list[RuleResult] = field(default_factory=list)
    reason: str | None = None
    seconds: float = 0.0
    digest: str | None = None
    fingerprint: str | None = None
    served: ServedProfile | None = None
    measurements: tuple[SuccessMeasurement, ...] = ()
    source: str | None = None

    @property
    def outcome(self) -> Outcome:
        """The worst of the gate's results; `not_applicable` if no rule had anything to prove."""
        outcomes = {result.outcome for result in self.results}
        for worst in (Outcome.FAIL, Outcome.ERROR, Outcome.NOT_RUN):
            if worst in outcomes:
                return worst
        return Outcome.PASS if outcomes & {Outcome.PASS, Outcome.WARN} else Outcome.NOT_APPLICABLE

    @property
    def finish(self) -> str | None:
        """The finish line; without times and paths, so that equal runs print equal lines."""
        if self.reason is not None:
            return None
        counts = count_outcomes(self.results)
        numbers = " ".join(f"{outcome}={counts[outcome]}" for outcome in Outcome if counts[outcome])
        line = (
            f"XPL-FINISH gate={self.name} {self.outcome} {numbers} digest={self.digest} fingerprint={self.fingerprint}"
        )
        return line if self.served is None else f"{line}{self.served.mark}"

    @property
    def profile(self) -> Profile | None:
        """The profile, if the gate served the adapter."""
        return None if self.served is None else self.served.name

    @property
    def stood_in(self) -> str | None:
        """Why the gate ran without the real model; None if it ran with it."""
        return None if self.served is None else self.served.sentence or None


@dataclass(frozen=True)
class Circumstances:
    """What a verdict depends on besides results: the options, and the state of the package.

    Attributes:
        narrowed: what the options left out, in a few words; empty if nothing.
        settings: keys of deploy.yml that `--set` overrides.
        placeholders: placeholders that the author has to fill in, `FILE:LINE`.
        unknown: model_io values that the manifest declares unknown.
        assumed: values that the manifest declares assumed.
        without_pairs: why there are no golden pairs to compare conversions with; None if there are.
        is_unrecorded: whether reference.py was never recorded.
        weights: what the weights are, if they are not trained ones; empty if they are.
    """

    narrowed: str = ""
    settings: tuple[str, ...] = ()
    placeholders: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    without_pairs: str | None = None
    is_unrecorded: bool = False
    weights: str = ""


@dataclass
class TargetReport:
    """All gates of one target.

    Attributes:
        circumstances: what its verdict (`verdict.verdict_of`) depends on besides the results.
        contents: text of the files that fixes edit, as the rules read it; no fix is applied to other content.
    """

    path: str
    name: str
    kind: str
    gates: list[GateReport] = field(default_factory=list)
    contents: dict[str, str] = field(default_factory=dict)
    circumstances: Circumstances = field(default_factory=Circumstances)

    @property
    def results(self) -> list[RuleResult]:
        """The results of all gates."""
        return [result for gate in self.gates for result in gate.results]


def outcome_of(findings: tuple[Finding, ...], severity: str) -> Outcome:
    """Return the outcome of a rule of a severity (`must`, `should`) with these findings."""
    if not findings:
        return Outcome.PASS
    fails = (severity == "must" if finding.must is None else finding.must for finding in findings)
    return Outcome.FAIL if any(fails) else Outcome.WARN


def count_outcomes(results: Iterable[RuleResult]) -> Counter[str]:
    """Return the number of results of each outcome."""
    return Counter(result.outcome for result in results)


def exit_code(targets: Iterable[TargetReport], fail_on: Outcome = Outcome.FAIL) -> ExitCode:
    """Return the exit code of an audit: findings before crashes before checks that could not run.

    Args:
        targets: the reports.
        fail_on: the mildest outcome that counts as a finding, `fail` or `warn`.

    Returns:
        `NOT_RUN` if a package proved nothing; `CLEAN` if no package had to be audited, because none changed.
    """
    targets = list(targets)
    outcomes = [{gate.outcome for gate in target.gates} for target in targets]
    if any(result.outcome in {Outcome.FAIL, fail_on} for target in targets for result in target.results):
        return ExitCode.FINDINGS
    if any(Outcome.ERROR in gate_outcomes for gate_outcomes in outcomes):
        return ExitCode.INTERNAL
    return ExitCode.CLEAN if all(_is_proven(found) for found in outcomes) else ExitCode.NOT_RUN


def _is_proven(outcomes: set[Outcome]) -> bool:
    """Return whether gates with these outcomes proved something and left nothing open."""
    return Outcome.PASS in outcomes and outcomes <= {Outcome.PASS, Outcome.NOT_APPLICABLE}
