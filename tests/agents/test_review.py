"""`xpl review`: real branches of real repositories, and what a bot says of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from tests.support import commands
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl_cli.agents.review import form, new_findings, page, review
from xpl_cli.agents.review.change import BranchChange, ChangedPackage, change_since
from xpl_cli.agents.review.description import TEMPLATE
from xpl_cli.agents.review.markdown import code
from xpl_cli.audit.formats import ReportContext
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.harm import Harm
from xpl_cli.audit.rules.model import Finding, GateReport, Outcome, RuleResult, TargetReport
from xpl_cli.basics import files
from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.git.history import Repository
from xpl_cli.basics.untrusted import in_markdown, one_line
from xpl_cli.packages.targets import AuditTarget
from xpl_cli.standard import spec

FORM = (ROOT / TEMPLATE).read_text(encoding="utf-8")
SWALLOWS = "\n    def reset(self):\n        try:\n            super().reset()\n        except:\n            pass\n"
STATIC = ("--base", "main", "--gate", "static")


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=Somebody", "-c", "user.email=somebody@example.org", "-c", "commit.gpgsign=false"]
    command = [str(shutil.which("git")), *who, *arguments]
    completed = subprocess.run(
        command, cwd=folder, check=True, capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    return completed.stdout.strip()


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository whose main branch has the form for policies and an adapter that warns."""
    folder = tmp_path_factory.mktemp("started")
    assert xpl("new-policy", "Foo", cwd=folder).returncode == ExitCode.CLEAN
    (folder / TEMPLATE).parent.mkdir(parents=True)
    (folder / TEMPLATE).write_text(FORM, encoding="utf-8")
    git(folder, "init", "--quiet", "--initial-branch=main")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "-m", "start")
    git(folder, "switch", "--quiet", "-c", "work")
    return folder


@pytest.fixture
def repository(started: Path, tmp_path: Path) -> Path:
    return shutil.copytree(started, tmp_path / "repository")


def add_policy(folder: Path, name: str = "Bar") -> Path:
    package = shutil.copytree(folder / "policy/Foo", folder / "policy" / name)
    for file in package.rglob("*"):
        if file.is_file():
            file.write_text(file.read_text(encoding="utf-8").replace("Foo", name), encoding="utf-8")
    return package


def spoil(package: Path, text: str = SWALLOWS) -> None:
    with (package / "model.py").open("a", encoding="utf-8") as model:
        model.write(text)


def reviewed(folder: Path, *options: str) -> dict[str, Any]:
    """Return a review as JSON; its exit code is the one that it names."""
    completed = xpl("review", *(options or STATIC), "--json", cwd=folder)
    document: dict[str, Any] = json.loads(completed.stdout)
    assert completed.returncode == document["exit_code"], completed.stderr
    return document


# --- What a change touches --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_packages_that_came_changed_or_went_are_told_and_others_left_alone(repository: Path) -> None:
    add_policy(repository, "Old")
    add_policy(repository, "Quiet")
    git(repository, "add", ".")
    git(repository, "commit", "--quiet", "-m", "more")
    git(repository, "branch", "--force", "main")
    shutil.rmtree(repository / "policy/Old")
    add_policy(repository)
    git(repository, "add", ".")
    git(repository, "commit", "--quiet", "-m", "work")
    (repository / "policy/Foo/notes.txt").write_text("not committed\n", encoding="utf-8")
    (repository / "README.md").write_text("about\n", encoding="utf-8")
    review = reviewed(repository)
    assert [(entry["path"], entry["change"]) for entry in review["packages"]] == [
        ("policy/Bar", "added"),
        ("policy/Foo", "changed"),
    ]
    assert (review["removed"], review["elsewhere"], review["verdict"]) == (["policy/Old"], 1, "open")


def test_a_change_of_no_package_is_reviewed_at_once(repository: Path) -> None:
    (repository / "README.md").write_text("about\n", encoding="utf-8")
    completed = xpl("review", *STATIC, cwd=repository)
    assert completed.returncode == ExitCode.CLEAN
    assert "touches no policy and no environment" in completed.stdout
    assert "|" not in completed.stdout


def test_it_may_be_called_from_a_folder_below(repository: Path) -> None:
    spoil(repository / "policy/Foo")
    review = reviewed(repository / "policy")
    assert [entry["name"] for entry in review["packages"]] == ["Foo"]
    assert review["next"][-1] == "xpl audit Foo --gate static"


@pytest.mark.parametrize("ref", ["nowhere", "--output=trace", ""])
def test_a_commit_that_is_not_there_is_told(repository: Path, ref: str) -> None:
    completed = xpl("review", f"--base={ref}", cwd=repository)
    assert (completed.returncode, completed.stdout) == (ExitCode.USAGE, "")
    assert "has no commit" in completed.stderr
    assert not (repository / "trace").exists()


def test_outside_of_git_nobody_knows_what_changed(tmp_path: Path) -> None:
    completed = xpl("review", "--base", "main", cwd=tmp_path)
    assert completed.returncode == ExitCode.USAGE
    assert "needs a git repository" in completed.stderr


# --- What is found ----------------------------------------------------------------------------------------------------


def test_what_the_base_has_already_is_marked(repository: Path) -> None:
    spoil(
        repository / "policy/Foo",
        "\n    def old(self):\n        try:\n            return 1\n        except:\n            return 0\n",
    )
    git(repository, "commit", "--quiet", "-am", "old")
    git(repository, "branch", "--force", "main")
    model = repository / "policy/Foo/model.py"
    model.write_text(f"# moved\n{model.read_text(encoding='utf-8')}{SWALLOWS}", encoding="utf-8")
    review = reviewed(repository)
    state = {entry["code"]: entry["was_there_before"] for entry in review["findings"]}
    assert state["XPL116"] is False
    assert state["XPL139"] is True  # the template's placeholders
    bare = next(entry for entry in review["findings"] if entry["code"] == "XPL131")
    assert bare["was_there_before"] is False
    assert len(bare["also"]) == 1


def test_a_package_may_be_the_whole_repository(started: Path, tmp_path: Path) -> None:
    package = shutil.copytree(started / "policy/Foo", tmp_path / "Renamed")
    git(package, "init", "--quiet", "--initial-branch=main")
    git(package, "add", ".")
    git(package, "commit", "--quiet", "-m", "start")
    spoil(package, "\n# changed\n")
    review = reviewed(package)
    assert [entry["path"] for entry in review["packages"]] == ["."]
    assert "XPL103" in {entry["code"] for entry in review["findings"]}
    assert all(entry["was_there_before"] for entry in review["findings"])


def test_the_whole_audit_is_in_every_format_of_it(repository: Path) -> None:
    spoil(repository / "policy/Foo")
    written = ("--output", "sarif=a.sarif", "--output", "github=a.txt", "--output", "review.md")
    completed = xpl("review", *STATIC, *written, cwd=repository)
    assert (completed.returncode, completed.stdout) == (ExitCode.FINDINGS, "")
    sarif = json.loads((repository / "a.sarif").read_text(encoding="utf-8"))
    assert "XPL116" in {result["ruleId"] for result in sarif["runs"][0]["results"]}
    assert "::error file=policy/Foo/model.py" in (repository / "a.txt").read_text(encoding="utf-8")
    document = (repository / "review.md").read_text(encoding="utf-8")
    assert document.startswith(f"{page.MARK}\n## xpl review: changes are needed\n")
    assert "1. **XPL116 reset-error-ignored** `policy/Foo/model.py:" in document
    assert reviewed(repository)["audit"]["schema"] == spec.schema("audit")["title"]


@pytest.mark.slow
def test_without_weights_the_shadow_is_audited(repository: Path) -> None:
    package = add_policy(repository)
    shutil.rmtree(repository / "policy/Foo")
    model = (package / "model.py").read_text(encoding="utf-8")
    head = "def load(self, config: Mapping[str, Any]) -> None:\n"
    assert head in model
    (package / "model.py").write_text(
        model.replace(head, f"{head}        import a_library_of_the_model\n\n        a_library_of_the_model.load()\n"),
        encoding="utf-8",
    )
    completed = xpl("review", "--base", "main", "--select", "XPL201", "--select", "XPL203", cwd=repository)
    assert "shadow mode" in completed.stdout, completed.stdout + completed.stderr
    assert "a\\_library\\_of\\_the\\_model is not installed" in completed.stdout
    assert completed.returncode == ExitCode.CLEAN


def test_every_requirement_has_a_place_in_the_order_of_harm() -> None:
    """A requirement that is new has to be judged; what sends wrong commands comes first."""
    assert {requirement.harm for requirement in spec.requirements().values()} == set(spec.harms())
    ranks = [Harm.of(f"XPL-{name}").rank for name in ("ACT-4", "EPI-1", "PKG-3", "CON-1", "PKG-5", "AUD-1")]
    assert ranks == list(range(len(spec.harms())))


# --- The page ---------------------------------------------------------------------------------------------------------


def finding(number: int, requirement: str, outcome: Outcome, message: str = "one is wrong") -> RuleResult:
    """Return a result with a finding in each of two lines."""
    lines = tuple(Finding(message, "model.py", line) for line in (number, number + 1))
    return RuleResult(f"XPL{number}", f"rule-{number}", requirement, "must", outcome, lines)


def of_results(*results: RuleResult) -> review.Review:
    """Return a review of one package with these results."""
    report = TargetReport("policy/Foo", "Foo", "policy", [GateReport(Gate.OFFLINE, list(results))])
    context = ReportContext(here=Path("/"))
    remarks = tuple(review._group_findings(review.listed_findings([report], context), set(), frozenset()))
    touched = ChangedPackage(AuditTarget(Path("/policy/Foo"), "policy", "policy/Foo"), "policy/Foo", 1, "added")
    return review.Review(BranchChange("main", "0" * 40, (touched,), (), ()), (report,), remarks, None, context)


def test_ten_findings_are_told_in_order_of_harm() -> None:
    made = of_results(
        *(finding(100 + number, "XPL-PKG-5", Outcome.FAIL) for number in range(10)),
        finding(120, "XPL-PKG-3", Outcome.WARN),
        finding(121, "XPL-EPI-1", Outcome.FAIL),
        finding(122, "XPL-ACT-4", Outcome.FAIL),
    )
    assert [remark.first.result.code for remark in made.reported] == [
        *("XPL122", "XPL121"),
        *(f"XPL{100 + number}" for number in range(8)),
    ]
    text = page.render(made)
    assert len(re.findall(r"^\d+\. \*\*XPL", text, re.MULTILINE)) == review.MOST
    assert "3 findings of less harm not listed: XPL108, XPL109, XPL120." in text
    assert "`policy/Foo/model.py:122`: sends a robot the wrong commands" in text
    assert "also `policy/Foo/model.py:123`" in text


def test_a_review_fits_into_a_comment_and_calls_nobody() -> None:
    made = of_results(
        finding(101, "XPL-ACT-1", Outcome.FAIL, "ask @everyone ![x](http://example.org/x) <b>now</b>"),
        finding(102, "XPL-ACT-2", Outcome.FAIL, "long " * 20_000),
        *(finding(number, "XPL-ACT-3", Outcome.FAIL, "short") for number in (103, 104)),
    )
    text = page.render(made)
    assert "XPL104" in text
    assert len(text) < 65_536
    assert len(page._truncate(["long"] * 20_000)) < 65_536
    assert "@everyone" not in text
    assert "!\\[x\\]" in text
    assert "<b>" not in text


# --- The description --------------------------------------------------------------------------------------------------


def filled(finish: list[str]) -> str:
    """Return the form, filled in."""
    text = re.sub(r"^- ([^:\[`]+):$", r"- \1: something", FORM, flags=re.MULTILINE)
    text = text.replace("- [ ]", "- [x]").replace("```text\n", "```text\n" + "".join(f"{line}\n" for line in finish))
    return text.replace("## What was not proved\n", "## What was not proved\n\nNo robot has seen it.\n")


def test_the_form_is_complete_once_it_is_filled_in() -> None:
    assert form.sections(FORM).keys() >= {"What it is", "What was proved", "What was not proved"}
    template = form.sections(FORM).values()
    unfilled = sum(len(section.fields) + len(section.boxes) for section in template)
    free = sum(not (section.fields or section.boxes) for section in template)
    assert len(list(form.unfilled_fields(FORM, FORM))) == unfilled + free
    assert list(form.unfilled_fields(filled(["XPL-FINISH"]), FORM)) == []
    assert list(form.unfilled_fields(filled(["XPL-FINISH"]).replace("\n", "\r\n"), FORM)) == []
    hidden = filled(["XPL-FINISH"]).replace("No robot has seen it.", "<!-- No robot has seen it. -->")
    assert list(form.unfilled_fields(hidden, FORM)) == ["What was not proved: the section is empty"]
    assert "is missing" in "".join(form.unfilled_fields("Please merge.", FORM))


@pytest.mark.slow
def test_a_policy_needs_a_description_that_belongs_to_its_files(repository: Path) -> None:
    package = add_policy(repository)
    completed = xpl("audit", "policy/Bar", "--gate", "static", "--json", cwd=repository)
    (gate,) = json.loads(completed.stdout)["targets"][0]["gates"]
    others = [f"XPL-FINISH gate={name} pass pass=1 digest=0 fingerprint=elsewhere" for name in ("offline", "mujoco")]
    text = repository / "description.md"
    options = (*STATIC, "--description", str(text))

    text.write_text(filled([gate["finish"], *others]), encoding="utf-8")
    review = reviewed(repository, *options)
    assert (review["verdict"], review["description"]["problems"]) == ("open", [])
    assert len(review["description"]["notes"]) == 2, "a digest of another machine is no proof here"

    shadow = f"{others[0]} profile=shadow"
    text.write_text(filled([gate["finish"], shadow]), encoding="utf-8")
    problems = reviewed(repository, *options)["description"]["problems"]
    assert problems == [
        "the offline gate ran without the model: run it where the weights are",
        "the XPL-FINISH line of the mujoco gate is missing",
    ]

    spoil(package, "\n# changed after the audit\n")
    text.write_text(filled([gate["finish"], *others]), encoding="utf-8")
    review = reviewed(repository, *options)
    assert review["exit_code"] == ExitCode.FINDINGS
    (problem,) = review["description"]["problems"]
    assert "the static gate of the description is not that of these files" in problem
    assert gate["digest"] in problem


@pytest.mark.slow
def test_a_description_is_held_against_the_form_of_the_base(repository: Path) -> None:
    add_policy(repository)
    box = next(line for line in FORM.splitlines() if line.startswith("- [ ]"))
    (repository / TEMPLATE).write_text(FORM.replace(f"{box}\n", ""), encoding="utf-8")
    completed = subprocess.run(
        [sys.executable, "-m", "xpl_cli", "review", *STATIC, "--description", "-"],
        cwd=repository,
        input=filled(["XPL-FINISH gate=static pass pass=1 digest=0 fingerprint=elsewhere"]).replace(
            box.replace("[ ]", "[x]"), ""
        ),
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == ExitCode.FINDINGS
    assert "### Description" in completed.stdout
    assert "is missing" in completed.stdout


def test_a_small_change_needs_no_form(repository: Path) -> None:
    (repository / "policy/Foo/notes.txt").write_text("a note\n", encoding="utf-8")
    text = repository / "description.md"
    text.write_text("Adds a note.\n", encoding="utf-8")
    review = reviewed(repository, *STATIC, "--description", str(text))
    assert (review["description"]["form"], review["description"]["problems"]) == (None, [])
    assert "was not checked: the change adds no policy" in review["description"]["notes"][0]
    text.write_text(FORM, encoding="utf-8")
    assert reviewed(repository, *STATIC, "--description", str(text))["description"]["problems"]


# --- What counts, and what a description may be -----------------------------------------------------------------------


def test_what_was_there_before_makes_no_review_red_unless_asked(repository: Path) -> None:
    bad = "\n    def get_action_batch(self, wrong, order):\n        return []\n"
    spoil(repository / "policy/Foo", bad)
    git(repository, "commit", "--quiet", "-am", "a fault")
    git(repository, "branch", "--force", "main")
    with (repository / "policy/Foo/README.md").open("a", encoding="utf-8") as readme:
        readme.write("A typo less.\n")
    review = reviewed(repository)
    assert (review["verdict"], review["exit_code"]) == ("open", ExitCode.CLEAN)
    assert {entry["was_there_before"] for entry in review["findings"]} == {True}
    assert reviewed(repository, *STATIC, "--fail-on", "all")["exit_code"] == ExitCode.FINDINGS
    with (repository / "policy/Foo/model.py").open("a", encoding="utf-8") as model:
        model.write("\n    def reset(self, why):\n        pass\n")
    assert reviewed(repository)["exit_code"] == ExitCode.FINDINGS


def test_only_documents_leave_what_was_not_proved_before_open(repository: Path) -> None:
    (repository / "policy/Foo/README.md").write_text("about\n", encoding="utf-8")
    change = change_since("main", Repository.of(repository))
    assert [touched.documents_only for touched in change.packages] == [True]
    path = change.packages[0].target.shown
    gates = [
        GateReport(
            Gate.OFFLINE, results=[RuleResult("XPL201", "serves", "XPL-SRV-1", "must", outcome, findings, "why")]
        )
        for outcome, findings in ((Outcome.FAIL, (Finding("it"),)), (Outcome.NOT_RUN, ()))
    ]
    report = TargetReport(path=path, name="Foo", kind="policy", gates=gates)
    for same, expected in ((frozenset((path,)), Outcome.PASS), (frozenset[str](), None)):
        (judged,) = new_findings.without_old_findings([report], ReportContext(here=repository), set(), same)
        outcomes = [gate.outcome for gate in judged.gates]
        assert outcomes == ([expected] * 2 if expected else [Outcome.FAIL, Outcome.NOT_RUN])
    (repository / "policy/Foo/model.py").write_text("", encoding="utf-8")
    assert not change_since("main", Repository.of(repository)).packages[0].documents_only


@pytest.mark.parametrize("kind", ["device", "pipe", "folder", "huge"])
def test_a_description_that_is_no_text_is_refused(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(files, "_PATIENCE_S", 0.2)  # nobody ever writes to this pipe
    file = tmp_path / "description"
    if kind == "device":
        file = Path("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(file)
    elif kind == "folder":
        file.mkdir()
    else:
        file.write_bytes(b"x" * (1 << 20) + b"y")
    completed = commands.xpl("review", *STATIC, "--description", file, folder=repository)
    assert (completed.code, completed.stdout) == (ExitCode.USAGE, "")
    assert f"--description {file} " in completed.stderr
    assert commands.problem(completed) is None


@given(text=st.text(min_size=1))
def test_markdown_shows_a_text_as_it_is(text: str) -> None:
    reader = MarkdownIt("commonmark").enable("table").enable("strikethrough")
    plain = one_line(text)
    if plain:
        start, paragraph, end = reader.parse(f"x  \n{in_markdown(text)}")
        assert (start.type, end.type) == ("paragraph_open", "paragraph_close")
        inline = paragraph.children or []
        assert {token.type for token in inline} <= {"text", "text_special", "hardbreak"}
        shown = "".join(token.content for token in inline)
        assert shown.replace("\N{ZERO WIDTH SPACE}", "") == f"x{plain}".replace("\N{ZERO WIDTH SPACE}", "")
        (span,) = reader.parseInline(code(text))[0].children or []
        assert (span.type, span.content) == ("code_inline", plain)
