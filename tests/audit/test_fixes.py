"""Fixes: what a finding's edits do, what they never touch, and what `--fix` and `--diff` make of them."""

from __future__ import annotations

import shutil
import subprocess
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from tests.support.adapters.rules import made_adapter, made_room
from tests.support.peer import xpl
from xpl_cli.audit.engine import engine, fixes
from xpl_cli.audit.engine.fixtures import Fixture, build, fixtures
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Edit, Finding, Fix, GateReport, Outcome, RuleResult, TargetReport
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.packages.targets import AuditTarget

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.rules.registry import Rule

STATIC = AuditOptions(gates=(Gate.STATIC,))


SHOWS = {("file-order", "number-as-text")}
"""Rules whose fix shows what another one finds: names that are sorted are seen to be sorted as text."""
FIXTURES = [
    pytest.param(rule, fixture, id=f"{rule.slug}-{fixture.folder.name}")
    for rule in registry.rules()
    if rule.gate is Gate.STATIC
    for fixture in fixtures(rule)
    if not fixture.good
]


@pytest.mark.sampled(40)
@pytest.mark.parametrize(("rule", "fixture"), FIXTURES)
def test_a_fix_that_is_called_safe_can_be_carried_out_and_cures(rule: Rule, fixture: Fixture, tmp_path: Path) -> None:
    """It has edits; each alone makes its finding go away, no file stops parsing, and the rule finds nothing new.

    All fixes of the gate together leave none of its findings that carried edits, and no rule finds more than before.
    """
    adapter = build(fixture, tmp_path / "audited" / "Subject")
    options = AuditOptions(gates=(Gate.STATIC,), names=(rule.slug,))
    before = engine.audit(adapter, rule.target, options)
    assert _findings(before, rule.slug)
    for number, finding in enumerate(_findings(before, rule.slug)):
        assert finding.fix is not None
        if finding.fix.kind.endswith("_edit"):
            assert finding.fix.edits, finding
        if not finding.fix.edits:
            continue
        copy = shutil.copytree(adapter, tmp_path / str(number) / "Subject")
        (result,) = [result for result in before.results if result.slug == rule.slug]
        only = TargetReport(str(copy), "Subject", rule.target, contents=before.contents)
        only.gates.append(GateReport(Gate.STATIC, [replace(result, findings=(finding,))]))
        plan = fixes.plan(copy, only, unsafe=True)
        plan.apply()
        assert (plan.fixes, plan.refused) == (1, [])
        after = engine.audit(copy, rule.target, options)
        assert _messages(after, rule)[finding.message] < _messages(before, rule)[finding.message]
        assert _messages(after, rule) <= _messages(before, rule)
    is_advice = rule.folder.parent.name == registry.ADVICE  # which runs only where it is selected
    if not is_advice and any(finding.fix.edits for finding in _findings(before, rule.slug) if finding.fix):
        whole = engine.audit(adapter, rule.target, STATIC)
        plan = fixes.plan(adapter, whole, unsafe=True)
        plan.apply()
        assert not plan.refused
        fixed = engine.audit(adapter, rule.target, STATIC)
        assert not [finding for finding in _findings(fixed, rule.slug) if finding.fix and finding.fix.edits]
        for result in fixed.results:
            if (rule.slug, result.slug) not in SHOWS:
                assert len(result.findings) <= len(_findings(whole, result.slug)), result


def _messages(report: TargetReport, rule: Rule) -> Counter[str]:
    return Counter(finding.message for finding in _findings(report, rule.slug))


def _findings(report: TargetReport, slug: str) -> tuple[Finding, ...]:
    return next(result.findings for result in report.results if result.slug == slug)


# -- single edits ------------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one file of three lines."""
    (tmp_path / "a.txt").write_text("one\ntwö\nthree\n", encoding="utf-8")
    return tmp_path


def edit(line: int, column: int, end_line: int, end_column: int, text: str, *, name: str = "a.txt") -> Edit:
    """Return an edit of the file."""
    return Edit(name, line, column, end_line, end_column, text)


def planned(folder: Path, *wanted: Fix, unsafe: bool = False) -> fixes.FixPlan:
    """Return the plan of a report with these fixes; the files are read as they are now."""
    names = {one.path for fix in wanted for one in fix.edits if (folder / one.path).is_file()}
    texts = {name: (folder / name).read_bytes().decode("utf-8-sig", errors="replace") for name in names}
    contents = {name: text.replace("\r\n", "\n") for name, text in texts.items()}
    return fixes.plan(folder, reported(contents, *wanted), unsafe=unsafe)


def reported(contents: dict[str, str], *wanted: Fix) -> TargetReport:
    """Return a report with these fixes on files that held this."""
    findings = tuple(Finding(f"finding {place}", fix=fix) for place, fix in enumerate(wanted))
    result = RuleResult("XPL101", "slug", "XPL-PKG-1", "must", Outcome.FAIL, findings)
    return TargetReport("Foo", "Foo", "policy", [GateReport(Gate.STATIC, [result])], contents)


def fixed(folder: Path, *edits: Edit) -> str:
    """Apply one safe fix and return the file."""
    planned(folder, Fix("safe_edit", "", edits)).apply()
    return (folder / "a.txt").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("edits", "text"),
    [
        ([edit(2, 3, 2, 4, "o")], "one\ntwo\nthree\n"),
        ([edit(1, 1, 1, 1, "zero\n")], "zero\none\ntwö\nthree\n"),
        ([edit(2, 1, 3, 1, "")], "one\nthree\n"),
        ([edit(4, 1, 4, 1, "four\n")], "one\ntwö\nthree\nfour\n"),
        ([edit(3, 6, 3, 6, "!"), edit(1, 1, 1, 4, "uno")], "uno\ntwö\nthree!\n"),
    ],
)
def test_places_are_lines_and_characters_from_one(folder: Path, edits: list[Edit], text: str) -> None:
    assert fixed(folder, *edits) == text


def test_line_ends_byte_order_mark_encoding_and_mode_stay(folder: Path) -> None:
    """What is inserted follows the file, and a Python file its declaration."""
    file = folder / "a.txt"
    file.write_bytes(b"\xef\xbb\xbfone\r\ntwo\r\n")
    file.chmod(0o750)
    planned(folder, Fix("safe_edit", "", (edit(1, 1, 1, 4, "1\n1b"),))).apply()
    assert file.read_bytes() == b"\xef\xbb\xbf1\r\n1b\r\ntwo\r\n"
    assert file.stat().st_mode & 0o777 == 0o750
    python = folder / "a.py"
    python.write_bytes("# coding: latin-1\nname = 'ö'\n".encode("latin-1"))
    fix = Fix("safe_edit", "", (edit(2, 1, 2, 5, "title", name="a.py"),))
    fixes.plan(folder, reported({"a.py": python.read_text(encoding="latin-1")}, fix)).apply()
    assert python.read_bytes() == "# coding: latin-1\ntitle = 'ö'\n".encode("latin-1")


def test_unsafe_fixes_are_left_unless_asked_for(folder: Path) -> None:
    """And the plan counts them; commands and advice are for people."""
    fix = Fix("unsafe_edit", "", (edit(1, 1, 1, 4, "uno"),))
    left = planned(folder, fix, Fix("command", "rm -rf ."), Fix("advice", "think"))
    assert (left.fixes, left.unsafe, left.changes) == (0, 1, [])
    assert planned(folder, fix, unsafe=True).fixes == 1


def test_of_fixes_that_overlap_the_first_is_done_and_the_other_told(folder: Path) -> None:
    """A fix is done whole or not at all; equal edits of two findings are one."""
    first = Fix("safe_edit", "", (edit(1, 1, 1, 4, "uno"),))
    other = Fix("safe_edit", "", (edit(1, 2, 1, 3, "x"), edit(3, 1, 3, 6, "tre")))
    plan = planned(folder, first, first, other)
    assert (plan.fixes, plan.later) == (1, 1)
    plan.apply()
    assert (folder / "a.txt").read_text(encoding="utf-8") == "uno\ntwö\nthree\n"


def test_a_file_that_changed_since_the_audit_is_left_alone(folder: Path) -> None:
    fix = Fix("safe_edit", "", (edit(1, 1, 1, 4, "uno"),))
    plan = planned(folder, fix)
    (folder / "a.txt").write_text("one\nmeanwhile\n")
    with pytest.raises(UserError, match="changed while it was audited"):
        plan.apply()
    late = fixes.plan(folder, reported({"a.txt": "one\n"}, fix))
    assert (late.fixes, len(late.refused)) == (0, 1)
    assert (folder / "a.txt").read_text() == "one\nmeanwhile\n"


def test_links_and_files_outside_are_left_alone(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    other = tmp_path_factory.mktemp("other") / "b.txt"
    other.write_text("one\n")
    (folder / "link.txt").symlink_to(other)
    (folder / "inner").symlink_to(other.parent)
    for name in ("link.txt", "inner/b.txt", f"../{other.parent.name}/b.txt"):
        plan = planned(folder, Fix("safe_edit", "", (edit(1, 1, 1, 4, "uno", name=name),)))
        assert (plan.fixes, len(plan.refused)) == (0, 1)
    assert other.read_text() == "one\n"


@pytest.mark.parametrize(
    ("name", "text", "wrong"),
    [
        ("b.py", "x = 1\n", edit(1, 1, 1, 2, "(", name="b.py")),
        ("b.yml", "x: 1\n", edit(1, 4, 1, 5, "[", name="b.yml")),
        ("b.txt", "x\n", edit(7, 1, 7, 1, "y", name="b.txt")),
        ("b.txt", "x\n", edit(1, 9, 1, 9, "y", name="b.txt")),
    ],
)
def test_a_fix_that_would_break_a_file_is_left_out(folder: Path, name: str, text: str, wrong: Edit) -> None:
    """With its edits of other files; fixes of other files are done."""
    (folder / name).write_text(text)
    sound = Fix("safe_edit", "", (edit(1, 1, 1, 4, "uno"),))
    plan = planned(folder, Fix("safe_edit", "", (edit(3, 1, 3, 6, "tre"), wrong)), sound)
    assert plan.fixes == 1
    assert "a fault of a rule" in plan.refused[0]
    plan.apply()
    assert (folder / name).read_text() == text
    assert (folder / "a.txt").read_text(encoding="utf-8") == "uno\ntwö\nthree\n"


def test_if_one_file_cannot_be_written_none_is_changed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "b.txt").write_text("one\n")
    plan = planned(folder, Fix("safe_edit", "", (edit(1, 1, 1, 4, "uno"), edit(1, 1, 1, 4, "uno", name="b.txt"))))
    write = fixes.write_file

    def full(path: Path, content: bytes, mode: int) -> None:
        if path.name == "b.txt":
            raise OSError(28, "No space left on device")
        write(path, content, mode)

    monkeypatch.setattr(fixes, "write_file", full)
    with pytest.raises(UserError, match=r"b\.txt cannot be written, nothing was fixed: No space left"):
        plan.apply()
    assert (folder / "a.txt").read_text(encoding="utf-8").startswith("one")


# -- the command -------------------------------------------------------------------------------------------------------


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """Foo, whose deploy.yml names another policy and whose model hides errors of an import."""
    adapter = made_adapter(tmp_path / "policy/Foo")
    deploy = adapter / "deploy.yml"
    deploy.write_text(deploy.read_text().replace("policy_name: Foo", "policy_name: Bar"))
    with (adapter / "model.py").open("a") as model:
        model.write(
            "\n    def load(self, config):\n        try:\n            import vendor\n"
            "        except:\n            pass\n"
        )
    return tmp_path


def test_fix_does_safe_edits_and_audits_what_is_then_there(workspace: Path) -> None:
    """The gate is green afterwards; the unsafe edit is left."""
    done = xpl("audit", "policy/Foo", "--gate", "static", "--fix", cwd=workspace)
    assert done.returncode == ExitCode.CLEAN, done.stdout + done.stderr
    assert "policy_name: Foo" in (workspace / "policy/Foo/deploy.yml").read_text()
    assert "except:" in (workspace / "policy/Foo/model.py").read_text()


def test_a_diff_is_what_fix_does_and_writes_nothing(workspace: Path) -> None:
    before = _tree(workspace)
    options = ["audit", "policy/Foo", "--gate", "static", "--unsafe-fixes"]
    shown = xpl(*options, "--diff", cwd=workspace)
    assert shown.returncode == ExitCode.FINDINGS
    assert _tree(workspace) == before
    patched = workspace / "patched"
    shutil.copytree(workspace / "policy", patched / "policy")
    apply = [str(shutil.which("git")), "apply", "-"]
    subprocess.run(apply, cwd=patched, input=shown.stdout, text=True, check=True, capture_output=True)
    xpl(*options, "--fix", cwd=workspace)
    assert _tree(patched) == {path: text for path, text in _tree(workspace).items() if path.startswith("policy")}
    nothing = xpl(*options, "--diff", cwd=workspace)
    assert (nothing.returncode, nothing.stdout) == (ExitCode.CLEAN, "")


def _tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_several_packages_are_fixed_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The texts that the rules read come back from the processes that read them."""
    edit = "Edit('README.md', 1, 1, 1, 1, 'fixed\\n')"
    body = f"source.text('README.md')\nyield Finding('x', fix=Fix('safe_edit', '', ({edit},)))"
    made_room(tmp_path / "room", monkeypatch).rule("readme", body, code="XPL101")
    asked = [AuditTarget(made_adapter(tmp_path / name), "policy", name) for name in ("A", "B")]
    plan = fixes.plan_all(asked, STATIC)
    assert (plan.fixes, [change.display_path for change in plan.changes]) == (2, ["A/README.md", "B/README.md"])
    plan.apply()
    assert all((target.path / "README.md").read_text().startswith("fixed\n") for target in asked)
