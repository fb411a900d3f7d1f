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

    from xpl_cli.audit.rules.model import Finding, Result
    from xpl_cli.audit.rules.registry import Entry
    from xpl_cli.audit.rules.retired import Retired
    from xpl_cli.audit.static.source import Source

_KEY = "waivers"


@dataclass(frozen=True)
class Waiver:
    """One entry of `waivers` in policy.yml.

    Attributes:
        rule: slug or code of the rule whose findings it accepts.
        reason: why.
        message: how the messages of these findings begin; empty for all findings of the rule.
        place: position in the list, from 0.
    """

    rule: str
    reason: str
    message: str
    place: int

    @property
    def entry(self) -> Entry | None:
        """The rule, None if there is none of that name."""
        return lookup(self.rule)

    @property
    def retired(self) -> Retired | None:
        """The retired rule of that name, None if there was none."""
        return retired.lookup(self.rule)

    def covers(self, finding: Finding) -> bool:
        """Tell whether it accepts a finding of its rule."""
        return finding.message.startswith(self.message)


def read(source: Source) -> tuple[Waiver, ...]:
    """Return the waivers of an adapter. Entries that the manifest's schema refuses waive nothing."""
    name = sdk.File.POLICY_YML
    try:
        if _KEY not in source.text(name):
            return ()
    except NotRun:  # there is none, or it is too large
        return ()
    entries = source.manifest.data.get(_KEY)
    return tuple(_waivers(entries)) if isinstance(entries, list) else ()


def notes(source: Source) -> tuple[str, ...]:
    """Return what is to be said of waivers whose rule is retired: that they may be deleted, and what proves it now."""
    return tuple(
        f"{sdk.File.POLICY_YML} of {source.path.name}: waivers[{waiver.place}] may be deleted: {waiver.retired.text}"
        for waiver in read(source)
        if waiver.retired is not None
    )


def _waivers(entries: list[object]) -> Iterable[Waiver]:
    for place, given in enumerate(entries):
        if isinstance(given, dict):
            rule, reason, message = given.get("rule"), given.get("reason"), given.get("message", "")
            if all(isinstance(text, str) for text in (rule, reason, message)) and str(reason).strip():
                yield Waiver(str(rule), str(reason), str(message), place)


def waive(result: Result, waivers: Iterable[Waiver]) -> Result:
    """Return a result without the findings that are waived; they are kept apart, with the reason."""
    mine = [waiver for waiver in waivers if retired.current(waiver.rule) in {result.slug, result.code}]
    if not mine or not result.findings:
        return result
    left: list[Finding] = []
    accepted: list[Waived] = []
    for finding in result.findings:
        reason = next((waiver.reason for waiver in mine if waiver.covers(finding)), None)
        if reason is None:
            left.append(finding)
        else:
            accepted.append(Waived(finding, reason))
    outcome = outcome_of(tuple(left), result.severity)
    return replace(result, outcome=outcome, findings=tuple(left), waived=tuple(accepted))
