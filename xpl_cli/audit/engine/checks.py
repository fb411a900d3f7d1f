"""The rules of one gate on one target: each runs once, after those it needs; a crash is an outcome."""

from __future__ import annotations

import time
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.facts import fact_names
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Finding, NotApplicable, NotRun, Outcome, Proof, RuleResult, outcome_of
from xpl_cli.audit.rules.package_files import PackageFiles
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.rules.registry import RegistryError, prerequisites
from xpl_cli.audit.static.limits import LONGEST_S, TooLong, deadline
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.engine.cache import PassCache
    from xpl_cli.audit.rules.facts import Facts
    from xpl_cli.audit.rules.model import Numbers
    from xpl_cli.audit.rules.registry import Rule, RuleEntry

_UNRESPONSIVE = "the policy's actions do not depend on observations: that actions are equal proves nothing"
_UNLOADED = "what loading the model does decides, and in shadow mode it is not loaded: a pass proves nothing"
_HOLDS = frozenset((Outcome.PASS, Outcome.WARN, Outcome.NOT_APPLICABLE))


class Checks:
    """The results of a gate's rules, before waivers.

    Args:
        facts: the facts that rules need.
        cache: passes of earlier audits of the same content; None to run every rule.
    """

    def __init__(self, facts: Facts, cache: PassCache | None = None) -> None:
        self._facts = facts
        self._cache = cache
        self._results: dict[str, RuleResult] = {}
        self._seconds_left = LONGEST_S
        self._presence = PackageFiles.of(facts.get("path"))

    def result(self, entry: RuleEntry) -> RuleResult:
        """Return the result of a rule, running it first if it has not run yet.

        Raises:
            RegistryError: if the rules that it comes after contradict each other.
        """
        if entry.slug not in self._results:
            cached = self._cache.get(entry) if self._cache is not None else None
            self._results[entry.slug] = cached or self._run_or_crash(entry)
        return self._results[entry.slug]

    def _run_or_crash(self, entry: RuleEntry) -> RuleResult:
        rule: Rule | None = None
        try:
            rule = entry.load()
            result = self._unmet(rule) or self._run_check(rule)
            if self._cache is not None:
                self._cache.put(entry, result, fact_names(rule.check))
        except RegistryError:
            raise
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a rule's crash must not hide what the others find
            requirement = rule.requirement if rule is not None else ""
            loss = self._presence.loss
            if rule is not None and loss is not None:
                return self._result(rule, Outcome.NOT_RUN, reason=loss)
            if rule is not None and _is_of_the_server(rule, error):
                return self._result(rule, Outcome.NOT_RUN, reason=str(error))
            return RuleResult(entry.code, entry.slug, requirement, "must", Outcome.ERROR, reason=describe_crash(error))
        return result

    def _unmet(self, rule: Rule) -> RuleResult | None:
        """Return `not_run` for a rule with an unmet prerequisite, else None."""
        for other in prerequisites(rule):
            before = self.result(other)
            if before.outcome not in _HOLDS:
                needs = f"it needs {other.code} {other.slug}, which"
                if before.outcome is Outcome.FAIL:
                    return self._result(rule, Outcome.NOT_RUN, reason=f"{needs} does not hold")
                result = self._result(rule, Outcome.NOT_RUN, reason=f"{needs} could not be checked: {before.reason}")
                brief = before.brief or before.reason or ""
                return replace(result, brief=brief, advice=before.advice, lacks=before.lacks)
        return None

    def _run_check(self, rule: Rule) -> RuleResult:
        try:
            self._facts.get("options").time_limit.check()
            self._require_profile(rule)
            if (probe := self._facts.computed("probe")) is not None:
                probe.recorder.recent.clear()
            with self._limited_time() if rule.gate is Gate.STATIC else nullcontext():
                yielded = tuple(self._located(item, rule) for item in self._facts.call(rule.check))
            if not yielded:
                self._require_model(rule)
                self._require_responsive(rule)
        except NotApplicable as why:
            return self._result(rule, Outcome.NOT_APPLICABLE, reason=str(why))
        except NotRun as why:
            result = self._result(rule, Outcome.NOT_RUN, reason=str(why))
            return replace(result, brief=why.brief, advice=why.advice, lacks=why.lacks)
        except UserError as why:  # for example a manifest that cannot be read
            return self._result(rule, Outcome.NOT_RUN, reason=" ".join(str(why).split()))
        except TooLong:
            files = "the files are more, larger or more complex than any adapter's"
            reason = f"the gate was not done within {LONGEST_S:.0f} s: {files}"
            return self._result(rule, Outcome.NOT_RUN, reason=reason)
        findings = tuple(item for item in yielded if isinstance(item, Finding))
        proof = None if findings else next((item.numbers for item in yielded if isinstance(item, Proof)), None)
        return self._result(rule, outcome_of(findings, rule.severity), findings, proof=proof)

    def _located(self, item: Finding | Proof, rule: Rule) -> Finding | Proof:
        """Return a finding about a served adapter with the line at which it raised, or of the method that answered."""
        probe = self._facts.computed("probe") if rule.gate is not Gate.STATIC else None
        if probe is None or not isinstance(item, Finding):
            return item
        from xpl_cli.audit.engine.locations import located  # the static gate needs no client

        return located(item, rule, self._facts.get("source"), probe.recorder)

    @contextmanager
    def _limited_time(self) -> Iterator[None]:
        """End a rule that exceeds the remaining processor time of the gate."""
        began = time.process_time()
        try:
            with deadline(self._seconds_left):
                yield
        finally:
            self._seconds_left -= time.process_time() - began

    def _require_profile(self, rule: Rule) -> None:
        """Skip a rule that the profile of this run does not require.

        Raises:
            NotApplicable: if it judges the model itself, and the run has none.
            NotRun: if the adapter cannot be served, so that the profile is not known.
        """
        if rule.profile is Profile.FULL and self._facts.get("profile").name is Profile.SHADOW:
            raise NotApplicable("only the real model can satisfy or break it, and in shadow mode there is none")

    def _require_model(self, rule: Rule) -> None:
        """Discard the pass of a rule that judges what loading the model does, if it was not loaded.

        Raises:
            NotApplicable: in shadow mode.
        """
        if rule.loads and self._facts.get("profile").name is Profile.SHADOW:
            raise NotApplicable(_UNLOADED)

    def _require_responsive(self, rule: Rule) -> None:
        """Discard the pass of a rule that compares actions, if they would be equal whatever the adapter does.

        Raises:
            NotApplicable: if the actions do not depend on observations.
        """
        if rule.compares and not self._facts.get("probe").depends_on_observations:
            raise NotApplicable(_UNRESPONSIVE)

    def _result(
        self,
        rule: Rule,
        outcome: Outcome,
        findings: tuple[Finding, ...] = (),
        reason: str | None = None,
        proof: Numbers | None = None,
    ) -> RuleResult:
        return RuleResult(
            rule.code,
            rule.slug,
            rule.requirement,
            rule.severity,
            outcome,
            findings,
            reason,
            proof=proof,
            tries=rule.tries,
        )


def _is_of_the_server(rule: Rule, error: BaseException) -> bool:
    """Return whether an experiment lost its server; rules about servers report that."""
    if rule.gate is Gate.STATIC:
        return False
    from xpl.client import ClientError  # the static gate needs no client

    return isinstance(error, ClientError)


def describe_crash(error: BaseException) -> str:
    """Return type, message and location of an exception, in one line."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})" if trace else ""
    return f"{type(error).__name__}: {error}{where}"
