"""The rules of one gate on one target: each is run once, after those it needs, and its crash is an outcome."""

from __future__ import annotations

import time
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

from xpl_cli.audit.rules.facts import wanted
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Finding, NotApplicable, NotRun, Outcome, Proof, Result, outcome_of
from xpl_cli.audit.rules.presence import Presence
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.rules.registry import RegistryError, needed
from xpl_cli.audit.static.limits import LONGEST_S, TooLong, deadline
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xpl_cli.audit.engine.cache import Shelf
    from xpl_cli.audit.rules.facts import Facts
    from xpl_cli.audit.rules.model import Numbers
    from xpl_cli.audit.rules.registry import Entry, Rule

_DEAF = "the policy answers the same whatever it is shown: that answers are alike proves nothing"
_HOLDS = frozenset((Outcome.PASS, Outcome.WARN, Outcome.NOT_APPLICABLE))


class Checks:
    """The results of a gate's rules, before waivers.

    Args:
        facts: what rules may ask for.
        shelf: passes of earlier audits of the same content; None to run every rule.
    """

    def __init__(self, facts: Facts, shelf: Shelf | None = None) -> None:
        self._facts = facts
        self._shelf = shelf
        self._results: dict[str, Result] = {}
        self._left = LONGEST_S
        self._presence = Presence.of(facts.get("path"))

    def result(self, entry: Entry) -> Result:
        """Return what a rule finds, running it first if it has not run yet.

        Raises:
            RegistryError: if the rules that it comes after contradict each other.
        """
        if entry.slug not in self._results:
            kept = self._shelf.get(entry) if self._shelf is not None else None
            self._results[entry.slug] = kept or self._run(entry)
        return self._results[entry.slug]

    def _run(self, entry: Entry) -> Result:
        rule: Rule | None = None
        try:
            rule = entry.load()
            result = self._unmet(rule) or self._checked(rule)
            if self._shelf is not None:
                self._shelf.put(entry, result, wanted(rule.check))
        except RegistryError:
            raise
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a rule's crash must not hide what the others find
            requirement = rule.requirement if rule is not None else ""
            loss = self._presence.loss
            if rule is not None and loss is not None:
                return self._result(rule, Outcome.NOT_RUN, reason=loss)
            if rule is not None and _is_of_the_server(rule, error):
                return self._result(rule, Outcome.NOT_RUN, reason=str(error))
            return Result(entry.code, entry.slug, requirement, "must", Outcome.ERROR, reason=told(error))
        return result

    def _unmet(self, rule: Rule) -> Result | None:
        """Return the result of a rule that has nothing to build on."""
        for other in needed(rule):
            before = self.result(other)
            if before.outcome not in _HOLDS:
                why = "does not hold" if before.outcome is Outcome.FAIL else f"could not be checked: {before.reason}"
                return self._result(rule, Outcome.NOT_RUN, reason=f"it needs {other.code} {other.slug}, which {why}")
        return None

    def _checked(self, rule: Rule) -> Result:
        try:
            self._facts.get("options").clock.check()
            self._require(rule)
            with self._hurried() if rule.gate is Gate.STATIC else nullcontext():
                told = tuple(self._facts.call(rule.check))
            self._require_hearing(rule, told)
        except NotApplicable as why:
            return self._result(rule, Outcome.NOT_APPLICABLE, reason=str(why))
        except NotRun as why:
            return self._result(rule, Outcome.NOT_RUN, reason=str(why))
        except UserError as why:  # a manifest that cannot be read, for example: nothing that a rule could look at
            return self._result(rule, Outcome.NOT_RUN, reason=" ".join(str(why).split()))
        except TooLong:
            files = "the files are more, larger or more tangled than any adapter's"
            reason = f"the gate was not done within {LONGEST_S:.0f} s: {files}"
            return self._result(rule, Outcome.NOT_RUN, reason=reason)
        findings = tuple(item for item in told if isinstance(item, Finding))
        proof = None if findings else next((item.numbers for item in told if isinstance(item, Proof)), None)
        return self._result(rule, outcome_of(findings, rule.severity), findings, proof=proof)

    @contextmanager
    def _hurried(self) -> Iterator[None]:
        """End a rule that takes more processor time than those before it have left over."""
        began = time.process_time()
        try:
            with deadline(self._left):
                yield
        finally:
            self._left -= time.process_time() - began

    def _require(self, rule: Rule) -> None:
        """Stop a rule that the profile of this run does not require.

        Raises:
            NotApplicable: if it judges the model itself, and the run has none.
            NotRun: if the adapter cannot be served, so that the profile is not known.
        """
        if rule.profile is Profile.FULL and self._facts.get("profile").name is Profile.SHADOW:
            raise NotApplicable("only the real model can satisfy or break it, and in shadow mode there is none")

    def _require_hearing(self, rule: Rule, told: tuple[object, ...]) -> None:
        """Drop the pass of a rule that compares answers, where they would be alike whatever the adapter does.

        Raises:
            NotApplicable: if they do not depend on what is shown.
        """
        if rule.compares and not told and not self._facts.get("probe").hears:
            raise NotApplicable(_DEAF)

    def _result(
        self,
        rule: Rule,
        outcome: Outcome,
        findings: tuple[Finding, ...] = (),
        reason: str | None = None,
        proof: Numbers | None = None,
    ) -> Result:
        return Result(rule.code, rule.slug, rule.requirement, rule.severity, outcome, findings, reason, proof=proof)


def _is_of_the_server(rule: Rule, error: BaseException) -> bool:
    """Tell whether a server that an experiment talked to is gone or silent, which rules about servers report."""
    if rule.gate is Gate.STATIC:
        return False
    from xpl.client import ClientError  # the static gate needs no client

    return isinstance(error, ClientError)


def told(error: BaseException) -> str:
    """Return what a crash was and where, in one line."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})" if trace else ""
    return f"{type(error).__name__}: {error}{where}"
