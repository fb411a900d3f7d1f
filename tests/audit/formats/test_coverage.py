"""The report says in words what was tried, what does not concern the package, and what could not be tried."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.audit.formats import sample
from xpl_cli.audit.formats import ReportContext, as_json, render
from xpl_cli.audit.formats.coverage import Coverage
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, RuleResult, TargetReport
from xpl_cli.standard.validate import validate

CONTEXT = ReportContext(Path("/nowhere"), rule=sample.RULES.__getitem__)


def result(code: str, outcome: Outcome, tries: str = "", reason: str | None = None, brief: str = "") -> RuleResult:
    return replace(sample.result(code, outcome, reason=reason), tries=tries, brief=brief)


def shown(gate: GateReport) -> list[str]:
    """Return the lines of the text report without the verdict and what follows."""
    text = render("text", [TargetReport("/x/policy/Foo", "Foo", "policy", [gate])], CONTEXT)
    return text.partition("\nverdict")[0].splitlines()[1:]


def test_every_rule_that_runs_a_package_says_what_it_tries() -> None:
    """In few and short phrases without commas, which are listed with commas between them."""
    phrases = {rule.tries for rule in registry.rules() if rule.gate is not Gate.STATIC}
    assert all(phrase and "," not in phrase and len(phrase) <= 40 for phrase in phrases), phrases
    assert not any(rule.tries for rule in registry.rules() if rule.gate is Gate.STATIC)  # their passes are cached
    assert len({rule.tries for rule in registry.rules() if rule.gate is Gate.OFFLINE and rule.target == "policy"}) < 40


def test_each_thing_is_tried_or_not_and_named_once() -> None:
    """A phrase that one rule tried counts as tried, though another rule of it does not apply."""
    gate = GateReport(
        Gate.OFFLINE,
        [
            result("XPL203", Outcome.PASS, "batches"),
            result("XPL204", Outcome.NOT_APPLICABLE, "batches", "one environment"),
            result("XPL260", Outcome.NOT_APPLICABLE, "golden pairs", "there is no reference.py: unproven"),
            result("XPL301", Outcome.NOT_APPLICABLE, "swaps", "there is no reference.py: unproven"),
            RuleResult("XPL501", "stale-waiver", "XPL-AUD-1", "must", Outcome.NOT_APPLICABLE, reason="no waivers"),
        ],
    )
    coverage = Coverage.of(gate)
    assert coverage.tried == ("batches",)
    assert [item.subjects for item in coverage.needless] == [("golden pairs", "swaps")]
    assert shown(gate)[-2:] == ["offline tried: batches", "  not tried: golden pairs, swaps (there is no reference.py)"]


def test_without_a_phrase_the_area_of_the_requirement_counts() -> None:
    gate = GateReport(Gate.STATIC, [result("XPL110", Outcome.PASS), result("XPL121", Outcome.PASS)])
    assert shown(gate)[-1] == "static read: images, batches"


def test_a_root_of_not_run_is_told_once_and_short() -> None:
    """Whatever each rule's own reason says on top of it; paths of the package are relative."""
    root = "torch is not installed"
    gate = GateReport(
        Gate.OFFLINE,
        [
            result("XPL203", Outcome.NOT_RUN, "order", f"{root}; tried /x, /y and /z", root),
            result("XPL204", Outcome.NOT_RUN, "empty", f"it needs XPL203: {root}; tried /x, /y and /z", root),
            result("XPL260", Outcome.NOT_RUN, "pairs", "/x/policy/Foo/pairs.npz cannot be read"),
        ],
    )
    assert [line for line in shown(gate) if "not run," in line] == [
        f"  not run, XPL203, XPL204: {root}",
        "  not run, XPL260: pairs.npz cannot be read",
    ]
    told = render("github", [TargetReport("policy/Foo", "Foo", "policy", [gate])], CONTEXT)
    assert told.count(root) == 1
    document = as_json([TargetReport("policy/Foo", "Foo", "policy", [gate])], CONTEXT)
    assert validate(document, "audit") == []
    assert document["targets"][0]["gates"][0]["untried"][0] == {
        "subjects": ["order", "empty"],
        "outcome": "not_run",
        "reason": root,
    }
