"""The formats of platforms are what each of them documents, and no text of a finding breaks out of them."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.audit.formats import sample
from xpl_cli.audit.formats import ReportContext, render
from xpl_cli.audit.formats.github import CAP, command
from xpl_cli.audit.formats.junit import render as junit
from xpl_cli.audit.formats.linehash import line_hashes
from xpl_cli.audit.formats.rdjson import byte_column
from xpl_cli.audit.formats.sarif import artifact
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Edit, Finding, Fix, GateReport, Outcome, RuleResult, TargetReport
from xpl_cli.basics.untrusted import escape_controls, in_xml

TEXT = st.text(st.characters(exclude_categories=["Cs"]), min_size=1)


@pytest.fixture
def context(tmp_path: Path) -> ReportContext:
    """A checkout that holds the files of the sample."""
    return sample.repository(tmp_path)


# -- SARIF -------------------------------------------------------------------------------------------------------------


def test_sarif_is_what_code_scanning_reads(context: ReportContext) -> None:
    """The schema holds, and results refer to their rules; MUST is an error, and what was waived no alert."""
    document = json.loads(render("sarif", sample.reports(), context))
    assert sample.problems(document, "sarif") == []
    (run,) = document["runs"]
    rules = run["tool"]["driver"]["rules"]
    assert all(rules[result["ruleIndex"]]["id"] == result["ruleId"] for result in run["results"])
    assert all((result["level"] == "warning") == (result["ruleId"] == "XPL120") for result in run["results"])
    assert "build.example" not in json.dumps(run)
    assert run["invocations"][0]["executionSuccessful"] is False
    assert len(run["invocations"][0]["toolExecutionNotifications"]) == 3


def test_every_real_rule_fits_into_sarif(context: ReportContext) -> None:
    """Code scanning refuses descriptions that are too long."""
    rules = registry.rules()
    results = [RuleResult(rule.code, rule.slug, rule.requirement, rule.severity, Outcome.PASS) for rule in rules]
    report = TargetReport("policy/Foo", "Foo", "policy", [GateReport(Gate.STATIC, results)])
    document = json.loads(render("sarif", [report], ReportContext(context.here)))
    assert sample.problems(document, "sarif") == []
    described = document["runs"][0]["tool"]["driver"]["rules"]
    assert [rule["id"] for rule in described if "help" in rule] == [rule.code for rule in rules]


@given(path=st.text(st.characters(exclude_characters="\0"), min_size=1).filter(lambda text: text[0] != "/"))
def test_a_uri_leads_back_to_its_path(path: str) -> None:
    """Whatever a file is called, it is one relative URI without a scheme."""
    try:
        os.fsencode(path)
    except UnicodeEncodeError:  # a surrogate that stands for no byte: no file has this name
        return
    location = artifact(path)
    assert location["uriBaseId"] == "%SRCROOT%"
    assert os.fsdecode(unquote(location["uri"], errors="surrogateescape").encode(errors="surrogateescape")) == path
    assert not re.search(r"[^A-Za-z0-9%/_.~-]", location["uri"])


@pytest.mark.parametrize(
    ("content", "hashes"),
    [
        ("", ["c129715d7a2bc9a3:1"]),
        (" a\nb\n  \t\tc\n d", ["271789c17abda88f:1", "54703d4cd895b18:1", "180aee12dab6264:1", "a23a3dc5e078b07b:1"]),
        (
            " hello; \t\nworld!!!\r\n\n\r  \t\tGreetings\r End\r\n",
            [
                "e9496ae3ebfced30:1",
                "fb7c023a8b9ccb3f:1",
                "ce8ba1a563dcdaca:1",
                "e20e36e16fcb0cc8:1",
                "b3edc88f2938467e:1",
                "c8e28b0b4002a3a0:1",
                "c129715d7a2bc9a3:1",
            ],
        ),
        (
            "Lorem ipsum dolor sit amet.\n" * 10,
            [
                *(f"a7f2ff13bc495cf2:{count}" for count in range(1, 7)),
                "a7f2ff1481e87703:1",
                "a9cf91f7bbf1862b:1",
                "55ec222b86bcae53:1",
                "cc97dc7b1d7d8f7b:1",
                "c129715d7a2bc9a3:1",
            ],
        ),
    ],
)
def test_line_hashes_are_those_of_the_upload_action(content: str, hashes: list[str]) -> None:
    """The known answers of github/codeql-action: other values make it complain at every finding."""
    assert line_hashes(content.encode()) == hashes


# -- GitHub ------------------------------------------------------------------------------------------------------------


def read_command(line: str) -> dict[str, Any]:
    """Read a workflow command as the runner does."""
    head, _, message = line.removeprefix("::").partition("::")
    kind, _, told = head.partition(" ")
    pairs = (entry.split("=", 1) for entry in told.split(","))
    return {"kind": kind, "message": _plain(message), "properties": {name: _plain(text, ":,") for name, text in pairs}}


def _plain(text: str, more: str = "") -> str:
    for character in f"\r\n{more}":
        text = text.replace(f"%{ord(character):02X}", character)
    return text.replace("%25", "%")


def test_github_commands_are_read_back(context: ReportContext) -> None:
    """Places stand in the repository; columns only where a finding has one line."""
    commands = [read_command(line) for line in render("github", sample.reports(), context).splitlines()]
    assert [problem for entry in commands for problem in sample.problems(entry, "github")] == []
    hostile = next(entry for entry in commands if entry["properties"].get("line") == "1")
    assert hostile["properties"] == {
        "file": "policy/Grün 1/scripts\\a,b:c.sh",
        "line": "1",
        "endLine": "3",
        "title": "XPL130 private-data",
    }
    assert "::error file=x::not a command" in hostile["message"]


@given(message=TEXT, title=TEXT, file=TEXT)
def test_a_github_command_is_one_line_and_loses_nothing(message: str, title: str, file: str) -> None:
    """No text ends a command, begins another one or changes a property."""
    line = command("error", message, file=file, title=title)
    assert "\n" not in line
    assert "\r" not in line
    properties = {"file": escape_controls(file), "title": escape_controls(title)}
    assert read_command(line) == {"kind": "error", "message": escape_controls(message), "properties": properties}


@pytest.mark.parametrize("count", [1, CAP, CAP + 1, 25])
def test_github_gets_ten_of_a_kind_and_is_told_of_the_rest(count: int, context: ReportContext) -> None:
    """GitHub would drop them without a word."""
    reports = sample.one_target(
        *(Finding(f"fault {number}", path=f"{number}.py", line=number + 1) for number in range(count))
    )
    doubts = (Finding(f"doubt {number}", path=f"{number}.yml") for number in range(count))
    warned = sample.result("XPL120", Outcome.WARN, *doubts)
    reports[0].gates[0].results.append(warned)
    kinds = [read_command(line) for line in render("github", reports, context).splitlines()]
    assert [entry["kind"] for entry in kinds].count("error") == min(count, CAP)
    assert [entry["kind"] for entry in kinds].count("warning") == min(count, CAP)
    told = [entry["message"] for entry in kinds if entry["kind"] == "notice"]
    assert len(told) == 1 + (count > CAP)  # the verdict, and what was left out
    assert count <= CAP or f"{count - CAP} more error" in told[1]


# -- rdjson ------------------------------------------------------------------------------------------------------------


def test_rdjson_counts_bytes_and_its_suggestion_mends_the_file(context: ReportContext) -> None:
    """The columns are those of the file's bytes: replacing the range gives the line that was meant."""
    document = json.loads(render("rdjson", sample.reports(), context))
    assert sample.problems(document, "rdjson") == []
    entry = next(entry for entry in document["diagnostics"] if entry["code"]["value"] == "XPL110")
    (suggestion,) = entry["suggestions"]
    assert suggestion["range"] == entry["location"]["range"]
    start, end = suggestion["range"]["start"], suggestion["range"]["end"]
    line = sample.MODEL.encode().split(b"\n")[start["line"] - 1]
    assert line[start["column"] - 1 : end["column"] - 1].decode() == "env_idx_list or self.alle"
    assert start["column"] == 17 + len("größe".encode()) - len("größe")
    assert suggestion["text"] == "self.alle if env_idx_list is None else env_idx_list"


def test_several_edits_of_a_finding_are_one_suggestion(context: ReportContext) -> None:
    """A reviewer accepts one replacement at a time; half a fix is none."""
    edits = (Edit("model.py", 5, 16, 5, 17, "("), Edit("model.py", 4, 9, 4, 14, "größte"))
    found = Finding("this", path="model.py", line=4, column=9, fix=Fix("safe_edit", "rename", edits))
    document = json.loads(render("rdjson", sample.one_target(found, path="policy/Grün 1"), context))
    (suggestion,) = document["diagnostics"][0]["suggestions"]
    assert suggestion["text"] == "größte = env_idx_list or self.alle  # 🤖 hier\n        return ("
    assert suggestion["range"] == {"start": {"line": 4, "column": 9}, "end": {"line": 5, "column": 17}}


def test_edits_of_other_files_are_no_suggestion(context: ReportContext) -> None:
    """A suggestion stands where its diagnostic stands."""
    edits = (Edit("deploy.yml", 1, 1, 1, 2, "x"),)
    found = Finding("this", path="model.py", line=4, column=9, fix=Fix("safe_edit", "rename", edits))
    document = json.loads(render("rdjson", sample.one_target(found, path="policy/Grün 1"), context))
    assert "suggestions" not in document["diagnostics"][0]


@given(line=TEXT.map(lambda text: text.replace("\n", " ")), column=st.integers(1, 30))
def test_a_byte_column_cuts_between_characters(line: str, column: int) -> None:
    """What stands before it is whole characters, as many as the column says."""
    found = byte_column([line], 1, column)
    assert found is not None
    assert line.encode()[: found - 1].decode() == line[: column - 1]


def test_without_the_file_a_range_has_lines_only(context: ReportContext) -> None:
    """A column in characters would be taken for one in bytes."""
    found = Finding("this", path="gone.py", line=4, column=9, end_line=5, end_column=2)
    document = json.loads(render("rdjson", sample.one_target(found), context))
    assert document["diagnostics"][0]["location"]["range"] == {"start": {"line": 4}, "end": {"line": 5}}


# -- JUnit ------------------------------------------------------------------------------------------------------------


def tree(element: ET.Element) -> dict[str, Any]:
    """Return an XML element as a map."""
    return {
        "tag": element.tag,
        "attributes": dict(element.attrib),
        "children": [tree(child) for child in element],
        "text": "" if len(element) else (element.text or ""),
    }


def test_junit_counts_what_it_lists_and_what_was_not_proved_is_an_error(context: ReportContext) -> None:
    """The totals are those of the cases; `not_run` is never skipped."""
    root = ET.fromstring(render("junit", sample.reports(), context))  # noqa: S314 - our own
    assert sample.problems(tree(root), "junit") == []
    for suite in [root, *root]:
        for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped"), ("tests", "testcase")):
            assert int(suite.attrib[name]) == len(list(suite.iter(tag)))
    waiting = [case for case in root.iter("testcase") if case.find("error[@type='not_run']") is not None]
    assert [case.attrib["name"][:6] for case in waiting] == ["XPL203", "XPL204", "XPL203"]


@given(text=st.text(min_size=1))
def test_junit_is_xml_whatever_a_finding_says(text: str) -> None:
    """Characters that XML cannot hold are written out or replaced; all others arrive."""
    found = Finding(text, path=f"x{text}")
    root = ET.fromstring(junit(sample.one_target(found), ReportContext(Path("/nowhere"))))  # noqa: S314 - our own
    (failure,) = root.iter("failure")
    assert failure.attrib["message"] == in_xml(text)
