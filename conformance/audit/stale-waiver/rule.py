"""XPL501: Every waiver matches a finding."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, Outcome, rule
from xpl_cli.audit.engine.checks import Checks
from xpl_cli.audit.engine.waivers import RuleWaiver
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.source import Source

_DELETE = Fix("advice", "delete the waiver; the history of the file keeps its reason")


@rule(code="XPL501", gate="static", requirement="XPL-AUD-1")
def stale_waiver(source: Source, waivers: tuple[RuleWaiver, ...], checks: Checks, gate: Gate) -> Iterator[Finding]:
    """A waiver no longer matches a finding.

    ## What it does
    Runs the rules that policy.yml waives, in every gate those of that gate, and checks that each waiver matches one of
    their findings: of its rule, with a message that starts as the waiver says. The waiver of a rule that could not run
    is not judged, and one that names a retired rule is not a finding: `xpl audit` prints a note that it may be deleted.

    ## Why it matters
    Waived findings are ignored. A waiver that outlives its reason hides the next finding of the same kind, which may be
    another bug.

    ## Example
    `waivers: [{rule: bare-except, reason: ...}]` after the `except:` was removed.

    ## Use instead
    Delete the waiver. To waive a single finding, give the start of its `message`.

    ## Fix safety
    No automatic fix: that the finding is gone may itself be unexpected.
    """
    line = key_line(source, sdk.File.POLICY_YML, "waivers") if waivers else 1
    judged = False
    for waiver in waivers:
        entry = waiver.entry
        if waiver.retired is not None or (entry is not None and not (entry.runs_in(gate) and entry.target == "policy")):
            continue
        judged = True
        if entry is None:
            wrong = f"names no rule: `xpl rules` has no {waiver.rule!r}"
        elif entry.closes:
            wrong = "is about waivers themselves, which cannot be waived"
        else:
            result = checks.result(entry)
            if result.outcome in {Outcome.NOT_RUN, Outcome.ERROR} or any(map(waiver.covers, result.findings)):
                continue
            beginning = f" whose message starts with {waiver.message!r}" if waiver.message else ""
            wrong = f"matches no finding: {waiver.rule} has none{beginning}"
        yield Finding(
            f"waivers[{waiver.index}] {wrong}; the next finding of this kind would be hidden",
            path=sdk.File.POLICY_YML,
            line=line,
            expected="a rule with a matching finding",
            got=f"rule {waiver.rule}" + (f", message {waiver.message!r}" if waiver.message else ""),
            fix=_DELETE,
        )
    if not judged:
        raise NotApplicable("the manifest waives no rule of this gate")
