"""Findings of one cause are one entry, and the most harmful come first."""

from __future__ import annotations

from pathlib import Path

from tests.audit.formats import sample
from xpl_cli.audit.formats import ReportContext, as_json, render
from xpl_cli.audit.formats.causes import CauseEntry, causes
from xpl_cli.audit.formats.listing import listed_findings
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import HANDLER, TRACEBACK, Finding, GateReport, Outcome, RuleResult, TargetReport
from xpl_cli.standard.validate import validate

CONTEXT = ReportContext(Path("/nowhere"), rule=sample.RULES.__getitem__)


def of(**results: tuple[RuleResult, ...]) -> tuple[TargetReport, list[CauseEntry]]:
    """Return a report with the results of some gates, and its causes."""
    gates = [GateReport(Gate(name), list(found)) for name, found in results.items()]
    report = TargetReport("policy/Foo", "Foo", "policy", gates)
    return report, causes(listed_findings([report], CONTEXT))


def titles(found: list[CauseEntry]) -> list[tuple[str, tuple[int, ...]]]:
    return [(cause.title, cause.lines) for cause in found]


def test_rules_that_point_to_one_line_are_one_entry() -> None:
    """Of the static and of the offline gate alike; a finding elsewhere stays on its own."""
    _, found = of(
        static=(
            sample.result("XPL109", Outcome.FAIL, Finding("counted", "model.py", 8)),
            sample.result("XPL110", Outcome.WARN, Finding("empty", "model.py", 9), Finding("empty", "deploy.py", 8)),
        ),
        offline=(
            sample.result("XPL204", Outcome.FAIL, Finding("raised", "model.py", 8, located_by=TRACEBACK)),
            sample.result("XPL203", Outcome.FAIL, Finding("other", "model.py", 8, end_line=9, located_by=TRACEBACK)),
        ),
    )
    assert titles(found) == [("XPL109, XPL204, XPL203, XPL110", (8, 9)), ("XPL110 empty-list-means-all", (8,))]
    assert [cause.fails for cause in found] == [True, False]


def test_findings_of_one_rule_in_one_file_are_one_entry_with_their_lines() -> None:
    places = (("model.py", 12), ("model.py", 5), ("train.sh", 5), ("model.py", 12), (None, None))
    _, found = of(static=(sample.result("XPL109", Outcome.FAIL, *(Finding("m", *place) for place in places)),))
    assert [cause.lines for cause in found] == [(5, 12), (5,), ()]
    assert [len(cause.entries) for cause in found] == [3, 1, 1]


def test_a_served_fault_belongs_to_the_line_that_breaks_the_same_requirement() -> None:
    """The method that answered is no cause: without such a line, faults of one area share it, and no others."""
    answered = Finding("another environment", "model.py", 30, located_by=HANDLER)
    offline = tuple(sample.result(code, Outcome.FAIL, answered) for code in ("XPL203", "XPL204", "XPL260"))
    _, found = of(static=(sample.result("XPL109", Outcome.WARN, Finding("m", "batch.py", 8)),), offline=offline)
    assert titles(found) == [
        ("XPL203, XPL109", (8,)),
        ("XPL204 batch-unknown", (30,)),
        ("XPL260 golden-parity", (30,)),
    ]
    assert found[0].located.finding.path == "batch.py"
    _, found = of(offline=offline)
    assert titles(found) == [("XPL203, XPL204", (30,)), ("XPL260 golden-parity", (30,))]


def test_the_most_harmful_comes_first_in_every_list() -> None:
    """Wrong commands before what breaks before configuration, whatever fails and whatever the codes are."""
    report, found = of(
        static=(
            sample.result("XPL101", Outcome.FAIL, Finding("missing", "train.sh")),
            sample.result("XPL120", Outcome.FAIL, Finding("unread", "deploy.yml", 2)),
            sample.result("XPL121", Outcome.FAIL, Finding("blue", "model.py", 3)),
        ),
        offline=(sample.result("XPL203", Outcome.WARN, Finding("swapped", "model.py", 30, located_by=HANDLER)),),
    )
    ranked = ["XPL203", "XPL121", "XPL101", "XPL120"]
    assert [cause.first.result.code for cause in found] == ranked
    text = render("text", [report], CONTEXT)
    assert sorted(ranked, key=text.index) == ranked
    document = as_json([report], CONTEXT)
    assert validate(document, "audit") == []
    assert [entry["codes"] for entry in document["targets"][0]["causes"]] == [[code] for code in ranked]
    rules = [result for gate in document["targets"][0]["gates"] for result in gate["results"]]
    named = {entry["fingerprint"] for result in rules for entry in result["findings"]}
    assert {name for entry in document["targets"][0]["causes"] for name in entry["findings"]} == named
