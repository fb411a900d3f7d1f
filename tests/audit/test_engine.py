"""The engine: order and isolation of rules, many packages at once, and which packages a request means."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

from tests.support.adapters.rules import Room, made_adapter, made_room
from tests.support.peer import xpl
from xpl_cli.audit.engine import engine
from xpl_cli.audit.engine.changed import select_changed
from xpl_cli.audit.engine.waivers import RuleWaiver, waive
from xpl_cli.audit.formats import document
from xpl_cli.audit.formats.listing import ReportContext
from xpl_cli.audit.rules.facts import Facts
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Finding, Outcome, RuleResult, outcome_of
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.registry import RegistryError
from xpl_cli.basics.errors import ExitCode
from xpl_cli.packages.targets import AuditTarget

if TYPE_CHECKING:
    from pathlib import Path

STATIC = AuditOptions(gates=(Gate.STATIC,))
NAMES = ("Bar", "Baz", "Foo")


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Room:
    """An empty conformance room."""
    return made_room(tmp_path / "room", monkeypatch)


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """A fresh scaffold."""
    return made_adapter(tmp_path / "Foo")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three adapters; Baz has a failure."""
    folder = tmp_path_factory.mktemp("workspace")
    for name in NAMES:
        made_adapter(folder / "policy" / name)
    deploy = folder / "policy/Baz/deploy.yml"
    deploy.write_text(deploy.read_text().replace("policy_name: Baz", "policy_name: Other"))
    return folder


def said(word: str, folder: Path) -> str:
    """Return a statement of a rule that leaves a trace."""
    return f"with open({str(folder / 'trace')!r}, 'a') as trace: trace.write({word!r})"


def outcomes(path: Path, options: AuditOptions = STATIC) -> dict[str, Outcome]:
    """Return the outcome of each rule of the static gate, in the order of the report."""
    return {result.slug: result.outcome for result in engine.audit(path, "policy", options).results}


# -- digests -----------------------------------------------------------------------------------------------------------


def _digests(adapter: Path) -> list[str | None]:
    """Return the digest of the static and of the offline gate."""
    gates = (Gate.STATIC, Gate.OFFLINE)
    return [gate.digest for gate in engine.audit(adapter, "policy", AuditOptions(gates=gates)).gates]


def test_documents_are_no_part_of_what_an_adapter_does(room: Room, adapter: Path) -> None:
    """README and licence change the digest of the gate that reads, and none of a gate that runs; code changes both."""
    room.rule("reads", "yield from ()", code="XPL101")
    room.rule("runs", "yield from ()", code="XPL201", folder="offline")
    first = _digests(adapter)
    (adapter / "README.md").write_text("# Another text\n")
    (adapter / "LICENSE.txt").write_text("another\n")
    second = _digests(adapter)
    assert (second[0] != first[0], second[1]) == (True, first[1])
    with (adapter / "model.py").open("a") as model:
        model.write("# another line\n")
    assert all(before != after for before, after in zip(second, _digests(adapter), strict=True))


def test_what_only_a_rule_of_a_package_asks_is_no_part_of_the_digest(room: Room, adapter: Path) -> None:
    """Others, who have not installed it, get the same digest; the rule runs, although its code comes first."""
    room.rule("ours", "yield from ()", code="XPL201", folder="offline")
    alone = engine.audit(adapter, "policy", AuditOptions(gates=(Gate.OFFLINE,))).gates[0]
    ask = "with probe.session() as policy:\n    policy.act(probe.observation(0, 3))\nyield from ()"
    room.rule("theirs", ask, code="THEIRS201", folder="offline", facts="probe, motions")
    both = engine.audit(adapter, "policy", AuditOptions(gates=(Gate.OFFLINE,))).gates[0]
    assert [result.outcome for result in both.results] == [Outcome.PASS, Outcome.PASS]
    assert (both.digest, both.fingerprint) == (alone.digest, alone.fingerprint)


# -- where a rule lies -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gate", Gate)
def test_a_rule_has_the_gate_and_the_name_of_its_folders(room: Room, gate: Gate) -> None:
    file = room.rule("here", "yield from ()", code="XPL101", folder=gate.value)
    (entry,) = room.entries()
    assert [runs for runs in Gate if entry.runs_in(runs)] == [gate]
    rule = entry.load()
    assert (rule.slug, rule.gate, rule.target, rule.folder) == ("here", gate, "policy", file.parent)


def test_a_rule_about_environments_says_in_which_gate_it_runs(room: Room) -> None:
    room.rule("here", "yield from ()", code="XPL401", folder="environments", gate="offline")
    (entry,) = room.entries()
    assert [runs for runs in Gate if entry.runs_in(runs)] == [Gate.OFFLINE]
    assert (entry.load().target, entry.load().gate) == ("env", Gate.OFFLINE)


@pytest.mark.parametrize(
    ("folder", "gate", "told"),
    [
        ("offline", "static", "folder says"),
        ("environments", None, "give gate="),
        ("other", None, "none of"),
    ],
)
def test_a_rule_that_contradicts_its_folder_is_a_mistake_of_the_registry(
    room: Room, folder: str, gate: str | None, told: str
) -> None:
    room.rule("here", "yield from ()", code="XPL101", folder=folder, gate=gate)
    with pytest.raises(RegistryError, match=told):
        room.entries()[0].load()


# -- order and isolation -----------------------------------------------------------------------------------------------


def test_a_rule_runs_after_those_it_needs_and_the_report_is_in_order_of_code(
    room: Room, adapter: Path, tmp_path: Path
) -> None:
    room.rule("first", f"{said('first ', tmp_path)}\nyield from ()", code="XPL101", after=("last",))
    room.rule("last", f"{said('last ', tmp_path)}\nyield from ()", code="XPL102")
    assert outcomes(adapter) == {"first": Outcome.PASS, "last": Outcome.PASS}
    assert (tmp_path / "trace").read_text() == "last first "


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("body", "outcome"),
    [
        ("raise ZeroDivisionError('on purpose')", Outcome.ERROR),
        ("raise SystemExit(3)", Outcome.ERROR),
        ("raise NotRun('no weights')", Outcome.NOT_RUN),
        ("raise NotApplicable('nothing there')", Outcome.NOT_APPLICABLE),
        ("yield Finding('a warning')", Outcome.WARN),
    ],
)
def test_a_rule_whose_ground_does_not_hold_is_not_run(room: Room, adapter: Path, body: str, outcome: Outcome) -> None:
    """It says on what it waited; others run. What does not apply, or only warns, holds."""
    room.rule("ground", body, code="XPL101")
    room.rule("upper", "yield from ()", code="XPL102", after=("ground",))
    room.rule("other", "yield from ()", code="XPL103")
    holds = outcome in {Outcome.NOT_APPLICABLE, Outcome.WARN}
    found = outcomes(adapter)
    assert found == {"ground": outcome, "upper": Outcome.PASS if holds else Outcome.NOT_RUN, "other": Outcome.PASS}
    alone = engine.audit(adapter, "policy", AuditOptions(gates=(Gate.STATIC,), names=("upper",))).results
    assert [(result.slug, result.outcome) for result in alone] == [("upper", found["upper"])]
    assert holds or "XPL101 ground" in str(alone[0].reason)


def test_a_rule_may_say_what_it_proved(room: Room, adapter: Path) -> None:
    proof = "from xpl_cli.audit import Proof\nyield Proof({'pairs': 3})"
    room.rule("proves", proof, code="XPL101")
    room.rule("finds", f"{proof}\nyield Finding('wrong')", code="XPL102")
    report = engine.audit(adapter, "policy", STATIC)
    assert [(result.proof, len(result.findings)) for result in report.results] == [({"pairs": 3}, 0), (None, 1)]
    told = document.as_json([report], ReportContext(fail_on=Outcome.FAIL))["targets"][0]["gates"][0]["results"]
    assert [result.get("proof") for result in told] == [{"pairs": 3}, None]


def test_a_crash_says_what_and_where(room: Room, adapter: Path) -> None:
    file = room.rule("crash", "raise ZeroDivisionError('on purpose')", code="XPL101")
    (result,) = engine.audit(adapter, "policy", STATIC).results
    assert result.reason == f"ZeroDivisionError: on purpose ({file}:{len(file.read_text().splitlines())})"


def test_rules_that_wait_for_each_other_are_a_mistake_of_the_registry(room: Room, adapter: Path) -> None:
    room.rule("one", "yield from ()", code="XPL101", after=("two",))
    room.rule("two", "yield from ()", code="XPL102", after=("three",))
    room.rule("three", "yield from ()", code="XPL103", after=("one",))
    with pytest.raises(RegistryError, match="one after two after three after one"):
        engine.audit(adapter, "policy", STATIC)


def test_a_rule_can_only_need_a_rule_of_its_gate(room: Room, adapter: Path) -> None:
    room.rule("one", "yield from ()", code="XPL101", after=("nobody",))
    with pytest.raises(RegistryError, match="'nobody', which is no rule of the static gate"):
        engine.audit(adapter, "policy", STATIC)


def test_a_fact_whose_provider_crashes_is_computed_once() -> None:
    asked = []

    def broken() -> None:
        asked.append(1)
        raise OSError("disk full")

    facts = Facts({}, {"broken": broken})
    for _ in range(2):
        with pytest.raises(OSError, match="disk full"):
            facts.get("broken")
    assert len(asked) == 1


# -- many packages -----------------------------------------------------------------------------------------------------


def targets(workspace: Path) -> list[AuditTarget]:
    """Return the packages of the workspace."""
    return [AuditTarget(workspace / "policy" / name, "policy", f"policy/{name}") for name in NAMES]


@pytest.mark.slow
def test_many_packages_at_once_give_what_each_gives_alone(workspace: Path) -> None:
    asked = targets(workspace)[::-1]
    together = engine.audit_all(asked, STATIC)
    alone = [engine.audit(target.path, target.kind, STATIC, display_path=target.shown) for target in asked]
    assert [report.path for report in together] == [target.shown for target in asked]
    assert [report.results for report in together] == [report.results for report in alone]
    assert [report.gates[0].finish for report in together] == [report.gates[0].finish for report in alone]


def test_a_package_that_kills_its_reader_is_an_error_and_takes_no_other_with_it(room: Room, workspace: Path) -> None:
    """Its process dies without a word, as under the kernel's memory limit."""
    room.rule("parses", "import os\nif source.path.name == 'Baz': os._exit(9)\nyield from ()", code="XPL101")
    reports = engine.audit_all(targets(workspace), STATIC)
    assert [report.gates[0].outcome for report in reports] == [Outcome.PASS, Outcome.ERROR, Outcome.PASS]
    assert "died" in str(reports[1].results[0].reason)


def test_all_means_every_package_below_policy_and_envs(workspace: Path) -> None:
    (workspace / "policy/notes").mkdir(exist_ok=True)
    done = xpl("audit", "--all", "policy/Foo", "--gate", "static", "--json", "--no-cache", cwd=workspace)
    report = json.loads(done.stdout)
    assert sorted(target["name"] for target in report["targets"]) == list(NAMES)
    assert done.returncode == ExitCode.FINDINGS


def test_all_without_packages_says_where_it_looked(tmp_path: Path) -> None:
    done = xpl("audit", "--all", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (ExitCode.NOT_FOUND, "")
    assert "policy/ and envs/" in done.stderr


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("name", "options", "code"),
    [
        ("Foo", [], ExitCode.CLEAN),
        ("Foo", ["--fail-on", "warn"], ExitCode.FINDINGS),
        ("Foo", ["--fail-on", "warn", "--ignore", "placeholders"], ExitCode.CLEAN),
        ("Baz", [], ExitCode.FINDINGS),
        ("Baz", ["--fail-on", "never"], ExitCode.USAGE),
        ("Baz", ["--unsafe-fixes"], ExitCode.USAGE),
    ],
)
def test_what_counts_for_the_exit_code_can_be_chosen(
    workspace: Path, name: str, options: list[str], code: ExitCode
) -> None:
    done = xpl("audit", f"policy/{name}", "--gate", "static", *options, cwd=workspace)
    assert done.returncode == code, done.stdout + done.stderr


# -- changed packages --------------------------------------------------------------------------------------------------


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A git repository with Foo and Bar, on a branch that left main."""
    for name in ("Foo", "Bar"):
        made_adapter(tmp_path / "policy" / name)
    (tmp_path / "policy/Foo/vendor").mkdir()
    (tmp_path / "policy/Foo/vendor/unread.py").write_text("VALUE = 1\n")
    git(tmp_path, "init", "--quiet", "--initial-branch=main")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "-m", "start")
    git(tmp_path, "switch", "--quiet", "-c", "work")
    return tmp_path


def git(folder: Path, *arguments: str) -> None:
    """Run git as somebody."""
    who = ["-c", "user.name=Somebody", "-c", "user.email=somebody@example.org", "-c", "commit.gpgsign=false"]
    command = [str(shutil.which("git")), *who, *arguments]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, stdin=subprocess.DEVNULL)


def changed(repository: Path, ref: str = "main") -> list[str]:
    """Return the packages that an audit of what changed looks at."""
    packages = [AuditTarget(repository / "policy" / name, "policy", f"policy/{name}") for name in ("Bar", "Foo")]
    return [target.path.name for target in select_changed(ref, packages)]


def test_only_packages_whose_files_changed_are_audited(repository: Path) -> None:
    """Committed, not committed, new and removed files of the boundary count.

    The inside of a vendored tree does not, as long as it is there; nor does what others changed on main meanwhile.
    """
    git(repository, "switch", "--quiet", "main")
    with (repository / "policy/Foo/deploy.py").open("a") as loop:
        loop.write("# changed\n")
    git(repository, "commit", "--quiet", "-am", "change")
    git(repository, "switch", "--quiet", "work")
    assert changed(repository) == []
    (repository / "policy/Foo/vendor/unread.py").write_text("VALUE = 2\n")
    (repository / "README.md").write_text("about\n")
    assert changed(repository) == []
    (repository / "policy/Bar/helper.py").write_text("VALUE = 1\n")
    assert changed(repository) == ["Bar"]
    with (repository / "policy/Foo/model.py").open("a") as model:
        model.write("# changed\n")
    git(repository, "commit", "--quiet", "-am", "change")
    assert changed(repository) == ["Bar", "Foo"]
    assert changed(repository, "HEAD") == ["Bar"]
    done = xpl("audit", "--all", "--gate", "static", "--changed-since", "HEAD", "--json", cwd=repository)
    assert [target["name"] for target in json.loads(done.stdout)["targets"]] == ["Bar"]
    (repository / "policy/Foo/vendor/unread.py").unlink()
    assert changed(repository, "HEAD") == ["Bar", "Foo"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("ref", ["nowhere", "--output=trace", ""])
def test_a_commit_that_is_not_there_is_told(repository: Path, ref: str) -> None:
    done = xpl("audit", "policy/Foo", f"--changed-since={ref}", cwd=repository)
    assert (done.returncode, done.stdout) == (ExitCode.USAGE, "")
    assert "has no commit" in done.stderr
    assert not (repository / "trace").exists()


def test_a_folder_outside_git_is_told(workspace: Path) -> None:
    done = xpl("audit", "policy/Foo", "--changed-since", "main", cwd=workspace)
    assert done.returncode == ExitCode.USAGE
    assert "needs a git repository" in done.stderr


@pytest.mark.parametrize(("must", "outcome"), [(True, Outcome.FAIL), (False, Outcome.WARN)])
def test_a_finding_may_be_milder_or_graver_than_its_rule_until_it_is_waived(must: bool, outcome: Outcome) -> None:
    assert outcome_of((Finding("unsure", must=must),), "must") is outcome
    findings = (Finding("mild"), Finding("grave", must=must))
    assert outcome_of(findings, "should") is outcome
    waived = waive(
        RuleResult("XPL237", "first", "XPL-ACT-8", "should", outcome, findings),
        [RuleWaiver("first", "so it is", "grave", 0)],
    )
    assert (waived.outcome, waived.findings) == (Outcome.WARN, findings[:1])
