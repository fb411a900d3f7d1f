"""`junit`: a test report as continuous integration servers read it: a suite for each gate, a case for each rule.

`not_run` is an error there and not skipped: what was not proven is never green.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from xpl_cli.audit.formats.listing import ListedFinding, ReportContext, listed_findings
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.verdict import verdict_of
from xpl_cli.basics.untrusted import in_xml, one_line

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl_cli.audit.rules.model import GateReport, RuleResult, TargetReport


def render(reports: Sequence[TargetReport], context: ReportContext) -> str:
    """Return the report as an XML document."""
    entries = listed_findings(reports, context)  # in the order in which suites name findings
    suites = [_suite(report, gate, entries) for report in reports for gate in report.gates]
    root = ET.Element("testsuites", {"name": "xpl audit", **_totals(suites)})
    root.extend(suites)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _suite(report: TargetReport, gate: GateReport, entries: Iterator[ListedFinding]) -> ET.Element:
    cases = [_case(report, gate, result, [next(entries) for _ in result.findings]) for result in gate.results]
    counts = {
        "tests": len(cases),
        "failures": sum(case.find("failure") is not None for case in cases),
        "errors": sum(case.find("error") is not None for case in cases),
        "skipped": sum(case.find("skipped") is not None for case in cases),
    }
    suite = ET.Element(
        "testsuite",
        {
            "name": in_xml(one_line(f"{report.path} {gate.name}")),
            **{name: str(count) for name, count in counts.items()},
            "time": f"{gate.seconds:.3f}",
        },
    )
    verdict = verdict_of(report)
    values = {"verdict": str(verdict), "proven": ", ".join(map(str, verdict.proven)), "stood_in": gate.stood_in or ""}
    properties = ET.SubElement(suite, "properties")
    for name, value in values.items():
        if value:
            ET.SubElement(properties, "property", {"name": name, "value": in_xml(one_line(value))})
    suite.extend(cases)
    return suite


def _case(report: TargetReport, gate: GateReport, result: RuleResult, entries: list[ListedFinding]) -> ET.Element:
    where = in_xml(one_line(f"{report.path}.{gate.name}"))
    attributes = {
        "classname": where,
        "name": f"{result.code} {result.slug}",
        "time": "0",
    }
    location = next(((entry.path, entry.finding.line) for entry in entries if entry.finding.path is not None), None)
    if location is not None:
        attributes |= {"file": in_xml(location[0])} | ({} if location[1] is None else {"line": str(location[1])})
    case = ET.Element("testcase", attributes)
    text = "\n\n".join(f"{_location_text(entry)}\n{entry.text}" for entry in entries)
    reason = result.reason or ""
    if result.outcome is Outcome.FAIL:
        _add_element(case, "failure", text, message=entries[0].finding.message, type=result.requirement)
    elif result.outcome is Outcome.WARN:
        _add_element(case, "system-out", text)
    elif result.outcome is Outcome.NOT_APPLICABLE:
        _add_element(case, "skipped", message=reason)
    elif result.outcome in {Outcome.ERROR, Outcome.NOT_RUN}:
        _add_element(case, "error", reason, message=reason, type=result.outcome.value)
    return case


def _location_text(entry: ListedFinding) -> str:
    return entry.path if entry.finding.line is None else f"{entry.path}:{entry.finding.line}"


def _add_element(case: ET.Element, tag: str, text: str | None = None, **attributes: str) -> None:
    element = ET.SubElement(case, tag, {name: in_xml(value) for name, value in attributes.items()})
    element.text = None if text is None else in_xml(text)


def _totals(suites: list[ET.Element]) -> dict[str, str]:
    counts = ("tests", "failures", "errors", "skipped")
    totals = {name: str(sum(int(suite.attrib[name]) for suite in suites)) for name in counts}
    return {**totals, "time": f"{sum(float(suite.attrib['time']) for suite in suites):.3f}"}
