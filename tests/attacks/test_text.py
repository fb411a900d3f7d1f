"""Names, messages and evidence that want to be more than text: for terminals, platforms, spreadsheets and browsers."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from tests.support.adapters.rules import made_adapter
from tests.support.peer import xpl
from xpl_cli.agents.review import page
from xpl_cli.agents.review.change import BranchChange, ChangedPackage
from xpl_cli.agents.review.review import Review, ReviewFinding
from xpl_cli.audit.formats import ReportContext, render
from xpl_cli.audit.formats.listing import listed_findings
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.harm import Harm
from xpl_cli.audit.rules.model import Finding, Fix, GateReport, Outcome, RuleResult, TargetReport
from xpl_cli.basics import failures, pages, untrusted
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.formats import REPORTS
from xpl_cli.evaluation.report import episodes, markdown
from xpl_cli.packages.targets import AuditTarget

EVIL = (
    "\x1b[31m\x1b]0;title\x07",
    "\x9b31m\x85",
    "a\n\n## Verdict: green\n\n![](https://evil.example/x.png)",
    "a\r\n::error::forged",
    "::set-output name=x::y",
    "##[add-mask]x",
    "](https://evil.example) [x](javascript:alert(1))",
    "@team Fixes #1, GH-7, owner/repo#3, www.evil.example, https://evil.example",
    "<img src=x onerror=alert(1)><!--",
    "\u202egnp.exe\u2066\u200f\u2028\u2029\ufeff",
    "=HYPERLINK(1)",
    "`` ` ```|a|b",
    "\ud800\udc80\ufffe\uffff\0",
    "\U000e0041\U000e0042",
    "' \" $(touch x) `touch y` ; touch z",
)
STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
TEXT = st.one_of(st.sampled_from(EVIL), st.text(), st.lists(st.sampled_from(EVIL), max_size=3).map("".join))


def reports(text: str) -> list[TargetReport]:
    """Return a report in which a package says something everywhere."""
    finding = Finding(
        text,
        path=f"{text}.py".replace("\ud800", ""),
        line=1,
        expected=text,
        got=text,
        evidence={text: text},
        fix=Fix("command", text),
    )
    failed = RuleResult("XPL102", "parses", "XPL-PKG-4", "must", Outcome.FAIL, (finding,))
    lost = RuleResult("XPL110", "batch-by-position", "XPL-BAT-1", "must", Outcome.NOT_RUN, reason=text)
    gates = [GateReport(name=Gate.STATIC, results=[failed, lost]), GateReport(Gate.OFFLINE, reason=text)]
    return [TargetReport(path=f"policy/{text}".replace("\ud800", ""), name=text, kind="policy", gates=gates)]


@pytest.mark.parametrize("name", REPORTS)
@pytest.mark.parametrize("text", EVIL)
def test_no_format_lets_a_name_steer_its_reader(name: str, text: str, tmp_path: Path) -> None:
    """No control character, no change of direction, no line of its own, and what is parsed parses."""
    written = render(name, reports(text), ReportContext(here=tmp_path))
    assert STEERING.search(written) is None
    harmless = render(name, reports("a" if name not in {"junit", "github"} else "a b"), ReportContext(here=tmp_path))
    if name in {"text", "github"}:
        assert written.count("\n") == harmless.count("\n")
    if name in {"json", "sarif", "rdjson"}:
        json.loads(written)
    if name == "junit":
        ET.fromstring(written)  # noqa: S314 - our own
    lines = written.splitlines()
    commands = [line for line in lines if line.lstrip().startswith("::")]
    assert len(commands) == (len(lines) if name == "github" else 0)
    if name == "text":
        assert "##[" not in written


def review(text: str) -> str:
    """Return the comment about a change of a package that says something everywhere."""
    (report,) = reports(text)
    context = ReportContext(here=Path("/nowhere"))
    (entry,) = listed_findings([report], context)
    remark = ReviewFinding(entry, (), Harm.of("XPL-PKG-4"), None)
    target = AuditTarget(Path("/nowhere") / "policy/x", "policy", report.path)
    change = BranchChange(text, "0" * 40, (ChangedPackage(target, report.path, 1, "added"),), (text,), ())
    return page.render(Review(change, (report,), (remark,) * 12, None, context))


@pytest.mark.parametrize("text", EVIL)
def test_a_comment_holds_nothing_of_a_name_but_its_letters(text: str) -> None:
    """In the block of what was left out, too: no heading, image, link, mention or reference of a stranger's."""
    written = review(text)
    assert STEERING.search(written) is None
    tokens = MarkdownIt("gfm-like", {"linkify": False}).parse(written)
    plain = MarkdownIt("gfm-like", {"linkify": False}).parse(review("a"))
    kinds = [token.type for token in tokens]
    assert [kind for kind in kinds if kind != "inline"] == [token.type for token in plain if token.type != "inline"]
    inner = [child for token in tokens for child in token.children or []]
    assert {child.type for child in inner}.isdisjoint({"image", "link_open", "html_inline"})
    shown = "".join(child.content for child in inner if child.type in {"text", "text_special"})
    assert re.search(r"@\w|#\d|GH-\d|://\w|www\.\w", shown) is None


@given(text=TEXT)
def test_a_sentence_in_markdown_links_and_calls_nowhere(text: str) -> None:
    """Not even where the platform makes links of what looks like one."""
    said = untrusted.in_markdown(text)
    assert STEERING.search(said) is None
    assert "\n" not in said
    assert "<" not in said
    assert re.search(r"@\w|#\d|://\w|www\.\w", said, re.IGNORECASE) is None


@given(text=TEXT)
def test_written_out_text_means_the_same_in_json(text: str) -> None:
    """So that whatever prints JSON may be read on a terminal, and by a program."""
    written = untrusted.escape_controls(json.dumps({"a": text}, ensure_ascii=False))
    assert STEERING.search(written) is None
    assert json.loads(written)["a"].encode("utf-16", "surrogatepass") == text.encode("utf-16", "surrogatepass")


@pytest.mark.parametrize("text", ["\udcff", *(word for word in EVIL if "\0" not in word)])
def test_a_command_that_is_offered_is_one_line_and_one_word(text: str) -> None:
    """What is pasted into bash arrives there letter by letter, and nothing of it runs."""
    line = untrusted.command(["printf", "%s", text])
    assert "\n" not in line
    assert STEERING.search(line) is None
    bash = shutil.which("bash")
    assert bash is not None
    done = subprocess.run([bash, "--norc", "-c", line], capture_output=True, check=True)
    assert done.stdout == os.fsencode(text)


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1+1", "@SUM(A1)", "\t=1", " =1", "\uff1d1", "\r=1"])
def test_no_cell_and_no_head_of_a_table_is_a_formula(text: str) -> None:
    """For the spreadsheet that opens it; numbers stay numbers."""
    rows = list(csv.reader(io.StringIO(episodes.as_csv([text, "b"], [[text, -1.5]]))))
    assert [row[0][0] for row in rows] == ["'", "'"]
    assert rows[1][1] == "-1.5"


@pytest.mark.parametrize("text", EVIL)
def test_reports_of_runs_show_names_as_they_are(text: str) -> None:
    """In the tables of Markdown, and in the data that a page's script reads."""
    table = markdown.table((text, "b"), [(text, 1)])
    assert table.count("\n") == 2
    assert STEERING.search(table) is None
    data = pages.as_json({"a": text})
    assert "<" not in data
    assert STEERING.search(data) is None


@pytest.mark.parametrize("text", EVIL)
def test_an_error_says_what_was_given_and_no_more(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    """What a command refuses may hold anything; no line of it passes for a command of a workflow, or a hint of ours."""
    from xpl_cli.basics import console

    console.note(failures.format_error(UserError(f"there is no {text}")).removesuffix("\n"))
    said = capsys.readouterr().err
    assert STEERING.search(said) is None
    first, *others = said.splitlines()
    assert first.startswith("error: there is no ")
    assert all(line.startswith("  ") for line in others if line)
    assert not any(line.lstrip().startswith("::") for line in said.splitlines())


@pytest.mark.slow
def test_a_package_may_have_any_name(tmp_path: Path) -> None:
    """From the command line, in every format at once, and in the commands that come next."""
    name = "\x1b[31m\n::error::@team ](http:) \u202e"
    made_adapter(tmp_path / "policy" / "Foo").rename(tmp_path / "policy" / name)
    others = [name for name in REPORTS if name != "text"]
    outputs = [f"--output={name}={tmp_path / name}" for name in others]
    done = xpl("audit", "--all", "--gate", "static", "--no-cache", *outputs, cwd=tmp_path)
    assert done.returncode == ExitCode.FINDINGS  # the name is no name of the standard
    written = [done.stdout, done.stderr, *((tmp_path / name).read_text(encoding="utf-8") for name in others)]
    assert not any(STEERING.search(text) for text in written)
    assert not any(line.startswith("::") for text in written[:2] for line in text.splitlines())
    document: dict[str, Any] = json.loads((tmp_path / "json").read_text(encoding="utf-8"))
    assert document["targets"][0]["name"] == name
    gone = xpl("audit", f"policy/{name}\x1b[0m", cwd=tmp_path)
    assert gone.returncode == ExitCode.NOT_FOUND
    assert STEERING.search(gone.stderr) is None
