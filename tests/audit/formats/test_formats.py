"""Every format says what its readers expect, whatever a finding holds; the sample and the schemas are in `formats/`."""

from __future__ import annotations

import io
import json
import math
import os
import re
import shlex
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.audit.formats import sample
from tests.support.adapters.rules import made_adapter, made_room
from tests.support.peer import xpl
from xpl_cli import __version__
from xpl_cli.audit.engine import engine
from xpl_cli.audit.formats import ReportContext, as_json, render
from xpl_cli.audit.formats.listing import listed_findings, repository_name
from xpl_cli.audit.formats.next_steps import audit_again, next_commands
from xpl_cli.audit.formats.output import ReportOutput
from xpl_cli.audit.formats.styled_text import OutputStyle
from xpl_cli.audit.formats.text import on_terminal
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Circumstances, Edit, Finding, Fix, GateReport, Outcome, TargetReport, exit_code
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.basics.formats import REPORTS
from xpl_cli.standard.validate import validate

SNAPSHOTS = Path(__file__).parent / "snapshots"
SUFFIXES = {"text": "txt", "github": "txt", "junit": "xml"}


@pytest.fixture
def context(tmp_path: Path) -> ReportContext:
    return sample.repository(tmp_path)


# -- all formats -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REPORTS)
def test_the_sample_looks_as_it_did(name: str, context: ReportContext) -> None:
    """A change of a format shows as a change of its snapshot, and so does a place of this machine."""
    text = render(name, sample.reports(), context).replace(__version__, "VERSION")
    file = SNAPSHOTS / f"{name}.{SUFFIXES.get(name, 'json')}"
    if os.environ.get("XPL_SNAPSHOTS") == "write":
        file.write_bytes(text.encode())
    assert text == file.read_bytes().decode()


@pytest.mark.parametrize("name", REPORTS)
def test_nothing_audited_is_a_valid_report(name: str, context: ReportContext) -> None:
    text = render(name, [], context)
    assert text == "" or text.endswith("\n")


@pytest.mark.parametrize("name", REPORTS)
def test_a_name_that_is_no_text_can_be_reported(name: str, context: ReportContext) -> None:
    """A file name may hold bytes that are not UTF-8; the report is UTF-8 all the same."""
    found = Finding("this file", path=os.fsdecode(b"sc\xffripts.py"), line=1, column=1)
    assert render(name, sample.one_target(found), context).encode()


@pytest.mark.parametrize("name", ["text", "github"])
@given(text=st.text(min_size=1))
def test_no_text_of_a_finding_commands_a_terminal(name: str, text: str) -> None:
    """What an adapter holds reaches a terminal without escape sequences, and starts no line of its own."""
    found = Finding(f"message {text}", path="model.py", line=1, got=text, evidence={"seen": text})
    shown = render(name, sample.one_target(found), ReportContext(Path("/nowhere"), rule=sample.RULES.__getitem__))
    if name != "github":  # escapes line ends; a workflow log shows other characters as they are
        assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", shown)
    assert not any(line.startswith("::") for line in shown.splitlines()) or name == "github"


def test_a_format_that_is_not_there_is_an_error() -> None:
    with pytest.raises(UserError, match=r"text, json, sarif, .*rdjson; got 'xml'"):
        ReportOutput.parse("xml", [])


# -- JSON --------------------------------------------------------------------------------------------------------------


def test_json_is_what_its_schema_says(context: ReportContext) -> None:
    assert validate(json.loads(render("json", sample.reports(), context)), "audit") == []


def test_paths_are_relative_to_the_repository_wherever_the_audit_runs(context: ReportContext) -> None:
    """From a subfolder the target has another path, its findings have not."""
    found = Finding("this", path="model.py", line=1)
    here = context.here / "policy"
    inside = as_json(sample.one_target(found, path="Grün 1"), ReportContext(here))
    (finding,) = inside["targets"][0]["gates"][0]["results"][0]["findings"]
    assert finding["path"] == "policy/Grün 1/model.py"
    assert inside["targets"][0]["path"] == "Grün 1"
    assert (
        finding["fingerprint"]
        == next(listed_findings(sample.one_target(found, path="policy/Grün 1"), context)).fingerprint
    )


def test_without_a_repository_the_workspace_or_the_absolute_path_counts(tmp_path: Path) -> None:
    """A checkout without `.git` names files the same; a folder that lies nowhere keeps its absolute path."""
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    assert repository_name(here / "policy/Foo", here) == "policy/Foo"
    assert repository_name(elsewhere / "policy/Foo", here) == "policy/Foo"
    assert repository_name(elsewhere / "Foo", here) == f"{elsewhere}/Foo"
    assert repository_name(here, here) == "."


# -- fingerprints ------------------------------------------------------------------------------------------------------


def test_a_fingerprint_survives_edits_and_tells_findings_apart(context: ReportContext) -> None:
    """Other lines and other numbers leave it; another file, rule, message or a second occurrence does not."""
    first = Finding("answers environment 3 when asked for 9", path="model.py", line=5)
    moved = Finding("answers environment 4 when asked for 11", path="model.py", line=90)
    other = Finding("answers environment 3 when asked for 9", path="deploy.py", line=5)

    def of(*findings: Finding, **options: str) -> list[str]:
        return [entry.fingerprint for entry in listed_findings(sample.one_target(*findings, **options), context)]

    assert of(first) == of(moved)
    differing = [*of(first), *of(other), *of(first, path="policy/Bar"), *of(first, rule="XPL101"), of(first, moved)[1]]
    assert len(set(differing)) == len(differing)


def test_every_fingerprint_of_a_report_is_unique(context: ReportContext) -> None:
    found = [entry.fingerprint for entry in listed_findings(sample.reports(), context)]
    assert len(set(found)) == len(found)


# -- for people --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 5, 9, 12, 20, 200])
def test_a_report_on_a_terminal_fits_one_screen(count: int, context: ReportContext) -> None:
    """With more findings it says less of each, and how to see them all."""
    found = [
        Finding(
            f"fault {number}: {'word ' * 12}",
            path=f"{number}.py",
            line=number + 1,
            got="x",
            expected="y",
            fix=_advice(),
        )
        for number in range(count)
    ]
    lines = on_terminal(sample.one_target(*found), context, OutputStyle(100)).splitlines()
    assert sum(max(1, math.ceil(len(line) / 100)) for line in lines) <= 40
    assert lines[-1].startswith("  xpl ")
    assert any("--output audit.txt" in line for line in lines) == (count > 29)
    if count <= 12:  # whole messages
        assert all(f"    fault {number}: {'word ' * 11}word" in lines for number in range(count))


def test_a_report_in_a_file_lists_every_finding(context: ReportContext) -> None:
    found = [Finding(f"fault {number}: {'word ' * 30}", path="model.py", line=number + 1) for number in range(50)]
    text = render("text", sample.one_target(*found), context)
    assert all(f"fault {number}: {'word ' * 29}word" in text for number in range(50))


def _advice() -> Fix:
    return Fix("advice", "write it again")


def test_many_targets_take_a_line_each_if_all_is_well(context: ReportContext) -> None:
    passed = [GateReport(gate, [sample.result("XPL101", Outcome.PASS)], digest="d", fingerprint="f") for gate in Gate]
    gates = [passed[: 3 if number < 30 else 1] for number in range(40)]
    reports = [TargetReport(f"policy/P{n}", f"P{n}", "policy", ran) for n, ran in enumerate(gates)]
    lines = render("text", reports, context).partition("\nnext\n")[0].splitlines()
    assert len(lines) == 41


def test_next_commands_can_be_pasted(context: ReportContext) -> None:
    commands = next_commands(sample.reports(), context)
    again = ["xpl", "audit", "policy/Grün 1", "--gate", "static", "--gate", "offline"]
    explained = [["xpl", "explain", code] for code in ("XPL109", "XPL110", "XPL101")]  # the most harmful first
    assert [shlex.split(line) for line in commands] == [*explained, again]
    alone = next_commands(sample.reports()[:1], context)
    assert [shlex.split(line) for line in alone] == explained  # the audit of this package was the command just given
    edit = Fix("safe_edit", "delete", (Edit("model.py", 1, 1, 2, 1, ""),))
    assert next_commands(sample.one_target(Finding("this", fix=edit)), context)[0].endswith("Foo --gate static --fix")


# -- where reports go --------------------------------------------------------------------------------------------------


def test_output_takes_the_report_and_stdout_stays_empty(
    context: ReportContext, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file holds what would have been printed; `FORMAT=FILE` writes besides what is printed."""
    file = tmp_path / "audit.sarif"
    ReportOutput.parse("sarif", [str(file)]).deliver(sample.reports(), context)
    assert file.read_text(encoding="utf-8") == render("sarif", sample.reports(), context)
    assert capsys.readouterr().out == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == [".git", "audit.sarif", "policy"]
    ReportOutput.parse("github", [f"{name}={tmp_path / name}" for name in ("junit", "text")]).deliver(
        sample.reports(), context
    )
    assert capsys.readouterr().out == render("github", sample.reports(), context)
    for name in ("junit", "text"):
        assert (tmp_path / name).read_bytes().decode() == render(name, sample.reports(), context)


def test_a_link_and_a_pipe_stay_what_they_are(context: ReportContext, tmp_path: Path) -> None:
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("old")
    link.symlink_to(file)
    ReportOutput.parse("json", [str(link)]).deliver(sample.reports(), context)
    assert link.is_symlink()
    assert file.read_text(encoding="utf-8") == render("json", sample.reports(), context)
    ReportOutput.parse("json", ["/dev/null"]).deliver(sample.reports(), context)
    assert not Path("/dev/null").is_file()


def test_an_output_that_cannot_be_written_is_told_before_the_audit(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="takes a file"):
        ReportOutput.parse("json", [str(tmp_path)])
    with pytest.raises(NotFoundError, match="there is no folder"):
        ReportOutput.parse("json", [str(tmp_path / "none" / "audit.json")])


def test_the_command_writes_and_fails_alike(tmp_path: Path) -> None:
    """The exit code does not depend on the format; stdout holds nothing but the report."""
    folder = tmp_path / "policy" / "Foo"
    folder.mkdir(parents=True)
    (folder / "model.py").write_text("class Model:\n    pass\n")
    plain = xpl("audit", "policy/Foo", "--gate", "static", cwd=tmp_path)
    assert plain.returncode == ExitCode.FINDINGS
    written = xpl("audit", "policy/Foo", "--gate", "static", "--format", "sarif", "--output", "a.sarif", cwd=tmp_path)
    assert (written.returncode, written.stdout) == (ExitCode.FINDINGS, "")
    assert sample.problems(json.loads((tmp_path / "a.sarif").read_text(encoding="utf-8")), "sarif") == []


# -- rules that are broken themselves ----------------------------------------------------------------------------------


@pytest.mark.parametrize("broken", ["syntax error(", "raise SystemExit(3)"])
def test_a_rule_that_cannot_be_imported_is_a_crash_in_every_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    """Its requirement is not known; it fails the audit, and hides nothing that the other rules find."""
    room = made_room(tmp_path / "conformance", monkeypatch)
    room.rule("broken", "yield from ()", code="XPL101").write_text(f'"""XPL101: broken."""\n{broken}\n')
    room.rule("finds", '"""Finds."""\nyield Finding("something", path="model.py", line=1)', code="XPL102")
    report = engine.audit(
        made_adapter(tmp_path / "Foo"), "policy", AuditOptions(gates=(Gate.STATIC,)), display_path="Foo"
    )
    context = ReportContext(tmp_path)
    texts = {name: render(name, [report], context) for name in REPORTS}
    assert exit_code([report]) is ExitCode.INTERNAL
    assert all("XPL101" in text and "something" in text for text in texts.values())
    assert validate(json.loads(texts["json"]), "audit") == []
    for name in ("sarif", "rdjson"):
        assert sample.problems(json.loads(texts[name]), name) == []
    (run,) = json.loads(texts["sarif"])["runs"]
    assert not run["invocations"][0]["executionSuccessful"]
    assert [result["ruleId"] for result in run["results"]] == ["XPL102"]


def test_commands_repeat_what_the_audit_was_asked(context: ReportContext) -> None:
    """Rules, settings and interpreter; a folder whose name begins like an option is no option."""
    wide = ReportContext(
        context.here, selection=("--select", "XPL1", "--fail-on", "warn"), running=("--set", "task=stack cups")
    )
    report = sample.one_target(Finding("this"), path="-odd name")
    again = ["xpl", "audit", "./-odd name", "--gate", "static", "--select", "XPL1", "--fail-on", "warn"]
    assert shlex.split(audit_again(report, wide)) == [*again, "--set", "task=stack cups"]
    passed = GateReport(Gate.STATIC, [sample.result("XPL101", Outcome.PASS)])
    green = [TargetReport("policy/Foo", "Foo", "policy", [passed])]
    assert next_commands(green, context) == ["xpl audit policy/Foo"]
    assert next_commands(green, wide) == []


@pytest.mark.parametrize(
    ("not_run", "is_unrecorded", "wanted"),
    [
        (["XPL260"], True, ["xpl model-io record"]),
        (["XPL203", "XPL260"], True, ["xpl serve", "xpl model-io record"]),
        (["XPL260"], False, ["xpl serve"]),
        ([], True, ["xpl model-io record", "xpl audit"]),
    ],
)
def test_missing_golden_pairs_are_recorded_next(
    context: ReportContext, not_run: list[str], is_unrecorded: bool, wanted: list[str]
) -> None:
    """Serving is next only where something else could not run; demonstrations are an option of the audit alone."""
    wide = ReportContext(context.here, running=("--python", "py"), demonstrations=("--demos", "demos"))
    results = [sample.result("XPL110", Outcome.PASS), *(sample.result(code, Outcome.NOT_RUN) for code in not_run)]
    later = GateReport(Gate.MUJOCO, [sample.result("XPL301", Outcome.NOT_RUN)], reason="the offline gate did not pass")
    gates = [GateReport(Gate.STATIC, results[:1]), *([GateReport(Gate.OFFLINE, results), later] if not_run else [])]
    around = Circumstances(is_unrecorded=is_unrecorded)
    commands = next_commands([TargetReport("policy/Foo", "Foo", "policy", gates, circumstances=around)], wide)
    assert [line.partition(" policy/Foo")[0] for line in commands] == wanted
    assert [line.endswith("--python py --demos demos") for line in commands] == [
        command == "xpl audit" for command in wanted
    ]


def test_a_terminal_gets_colours_and_lines_that_fit(context: ReportContext, monkeypatch: pytest.MonkeyPatch) -> None:
    """Words stay whole, what follows is indented, and commands are left in one piece."""
    message = "answers environment 3 when asked for 9, 環境 " * 4
    edit = Fix("safe_edit", "delete", (Edit("model.py", 1, 1, 2, 1, ""),))
    report = sample.one_target(Finding(message, path="model.py", line=3, fix=edit), path=f"policy/{'long' * 30}")
    plain = on_terminal(report, context, OutputStyle(60))
    coloured = on_terminal(report, context, OutputStyle(60, colour=True))
    assert re.sub(r"\x1b\[[\d;]*m", "", coloured) == plain
    assert "\x1b[1;31m" in coloured
    assert "\n      " in plain
    assert any(
        line.startswith("  xpl audit policy/longlong") and line.endswith(" static --fix") for line in plain.split("\n")
    )
    told = plain[plain.index("    answers") : plain.index("    fix: delete")]
    assert " ".join(told.split()) == message.strip()
    assert max(len(line) + line.count("環") + line.count("境") for line in told.split("\n")) <= 60
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert OutputStyle.of(io.StringIO()) == OutputStyle(None, colour=True)
    monkeypatch.setenv("NO_COLOR", "1")
    assert OutputStyle.of(io.StringIO()) == OutputStyle()
