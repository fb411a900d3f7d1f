"""Waivers: findings that an adapter's manifest declares accepted, each with a reason."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.audit.rules import retired
from xpl_cli.audit.rules.model import NotRun, Waived, outcome_of
from xpl_cli.audit.rules.registry import lookup

if TYPE_CHECKING:
    from collections.abc import Iterable

    from xpl_cli.audit.rules.model import Finding, RuleResult
    from xpl_cli.audit.rules.registry import RuleEntry
    from xpl_cli.audit.rules.retired import Retired
    from xpl_cli.audit.static.source import Source

_KEY = "waivers"


@dataclass(frozen=True)
class RuleWaiver:
    """One entry of `waivers` in policy.yml.

    Attributes:
        rule: slug or code of the rule whose findings it accepts.
        reason: why.
        message: prefix of these findings' messages; empty for all findings of the rule.
        place: position in the list, from 0.
    """

    rule: str
    reason: str
    message: str
    index: int

    @property
    def entry(self) -> RuleEntry | None:
        """The rule, or None if there is none of that name."""
        return lookup(self.rule)

    @property
    def retired(self) -> Retired | None:
        """The retired rule of that name, None if there was none."""
        return retired.lookup(self.rule)

    def covers(self, finding: Finding) -> bool:
        """Return whether it accepts a finding of its rule."""
        return finding.message.startswith(self.message)


def read(source: Source) -> tuple[RuleWaiver, ...]:
    """Return the waivers of an adapter. Entries that the manifest's schema refuses waive nothing."""
    name = sdk.File.POLICY_YML
    try:
        if _KEY not in source.text(name):
            return ()
    except NotRun:  # it does not exist, or is too large
        return ()
    entries = source.manifest.data.get(_KEY)
    return tuple(_waivers(entries)) if isinstance(entries, list) else ()


def notes(source: Source) -> tuple[str, ...]:
    """Return notes on waivers of retired rules: that they may be deleted, and which rules prove the same now."""
    return tuple(
        f"{sdk.File.POLICY_YML} of {source.path.name}: waivers[{waiver.index}] may be deleted: {waiver.retired.text}"
        for waiver in read(source)
        if waiver.retired is not None
    )


def _waivers(entries: list[object]) -> Iterable[RuleWaiver]:
    for index, entry in enumerate(entries):
        if isinstance(entry, dict):
            rule, reason, message = entry.get("rule"), entry.get("reason"), entry.get("message", "")
            if all(isinstance(text, str) for text in (rule, reason, message)) and str(reason).strip():
                yield RuleWaiver(str(rule), str(reason), str(message), index)


def waive(result: RuleResult, waivers: Iterable[RuleWaiver]) -> RuleResult:
    """Return a result with waived findings moved from `findings` to `waived`, each with its reason."""
    mine = [waiver for waiver in waivers if retired.current(waiver.rule) in {result.slug, result.code}]
    if not mine or not result.findings:
        return result
    remaining: list[Finding] = []
    accepted: list[Waived] = []
    for finding in result.findings:
        reason = next((waiver.reason for waiver in mine if waiver.covers(finding)), None)
        if reason is None:
            remaining.append(finding)
        else:
            accepted.append(Waived(finding, reason))
    outcome = outcome_of(tuple(remaining), result.severity)
    return replace(result, outcome=outcome, findings=tuple(remaining), waived=tuple(accepted))
