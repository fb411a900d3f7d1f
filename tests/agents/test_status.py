"""`xpl status`: whoever was interrupted reads where a package stands and what comes next; nothing is run for that."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.support.places import tracked
from tests.support.recordings.runs import renamed, synthetic
from tests.support.told import Command, fault
from xpl_cli.agents.status import memory, standing
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import GATES, Gate
from xpl_cli.audit.rules.model import Finding, GateReport, Outcome, Result, TargetReport
from xpl_cli.audit.rules.profiles import Choice, Profile
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.errors import ExitCode, NotFoundError
from xpl_cli.evaluation.records import fingerprints, records
from xpl_cli.main import app
from xpl_cli.scaffold import adapter, environment
from xpl_cli.scaffold.answers import Answers
from xpl_cli.standard import answers, spec

Status = Callable[..., dict[str, Any]]


@pytest.fixture(autouse=True)
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder of its own, whose audits nobody else remembers."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def foo(workspace: Path) -> Path:
    """Return a fresh adapter, policy/Foo."""
    files = adapter.render(Answers(**{"name": "Foo", **adapter.defaults()}))
    adapter.write(files, workspace / "policy" / "Foo")
    return workspace / "policy" / "Foo"


@pytest.fixture
def filled(foo: Path) -> Path:
    """Return an adapter in which nothing is left to fill in."""
    mark = spec.data("package")["placeholder"]
    for path in (path for path in foo.iterdir() if path.is_file()):
        path.write_text(path.read_text(encoding="utf-8").replace(mark, "done"), encoding="utf-8")
    return foo


def _run(*words: str) -> Any:
    done = CliRunner().invoke(app, words)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


def _status(*words: str) -> dict[str, Any]:
    """Return the answer, which is what its schema says, and whose commands the command line takes."""
    done = _run("status", *words, "--json")
    assert done.exit_code == ExitCode.CLEAN
    document: dict[str, Any] = json.loads(done.stdout)
    assert answers.problems(document) == []
    for one in (document, *document["packages"]):
        assert [
            told for line in one["next"] if (told := fault(Command(tuple(shlex.split(line)[1:]), exact=True)))
        ] == []
    return document


def _one(*words: str) -> dict[str, Any]:
    (package,) = _status(*words)["packages"]
    return {**package, "steps": {step["name"]: step for step in package["steps"]}}


def _audited(path: Path, *gates: GateReport, options: tuple[str, ...] = ()) -> None:
    """Remember gates as an audit of the files that are there now."""
    read = Source(path)
    found = [replace(gate, source=read.whole() if gate.name is Gate.STATIC else read.record()) for gate in gates]
    report = TargetReport(str(path), path.name, "policy", found)
    folder = standing.memory_folder()
    assert folder is not None
    memory.remember(folder, path, report, options)


def _gate(gate: Gate, outcome: Outcome, *findings: Finding, served: Choice | None = None) -> GateReport:
    result = Result("XPL203", "batch-order", "XPL-BAT-1", "must", outcome, findings, reason="for a reason")
    return GateReport(gate, [result], digest="d", fingerprint="f", served=served)


# -- one package -------------------------------------------------------------------------------------------------------


def test_a_fresh_adapter_has_places_to_fill_in_and_gates_ahead(foo: Path) -> None:
    """The first open step is the stage; one command takes all gates."""
    package = _one("policy/Foo")
    assert (package["verdict"], package["stage"]) == ("incomplete", "placeholders")
    places = package["steps"]["placeholders"]["detail"]
    file, _, line = places.removeprefix("fill in ").split(",")[0].partition(":")
    assert spec.data("package")["placeholder"] in (foo / file).read_text().splitlines()[int(line) - 1]
    assert [package["steps"][gate]["state"] for gate in Gate] == ["open"] * 3
    assert package["next"] == ["xpl audit policy/Foo"]


def test_an_audit_is_remembered_as_long_as_the_files_are_the_same(filled: Path) -> None:
    """By gate; a change makes it stale, and undoing the change makes it count again."""
    assert _run("audit", "policy/Foo", "--gate", "static").exit_code == ExitCode.CLEAN
    static = _one("Foo")["steps"]["static"]
    assert (static["state"], static["finish"].split()[:3]) == ("done", ["XPL-FINISH", "gate=static", "pass"])
    assert _one("Foo")["stage"] == "offline"
    model = filled / "model.py"
    text = model.read_text()
    model.write_text(f"{text}\n# changed\n")
    package = _one("Foo")
    assert (package["stage"], package["steps"]["static"]["state"]) == ("static", "stale")
    model.write_text(text)
    assert _one("Foo")["steps"]["static"]["state"] == "done"


def test_another_readme_is_judged_by_the_static_gate_alone(filled: Path) -> None:
    """What an adapter does is as it was."""
    _audited(filled, *(_gate(gate, Outcome.PASS) for gate in Gate))
    (filled / "README.md").write_text("# Another text\n")
    assert [_one("Foo")["steps"][gate]["state"] for gate in Gate] == ["stale", "done", "done"]


@pytest.mark.parametrize("options", [("--select", "parses"), ("--ignore", "parses"), ("--no-cache",)])
def test_an_audit_that_was_narrowed_is_not_remembered(foo: Path, options: tuple[str, ...]) -> None:
    """It proves less than the gate; and who asks to keep nothing gets that."""
    assert foo.is_dir()
    assert _run("audit", "policy/Foo", "--gate", "static", *options).exit_code == ExitCode.CLEAN
    assert _one("Foo")["steps"]["static"]["state"] == "open"


def test_what_a_gate_found_is_told_until_it_is_mended(foo: Path) -> None:
    """With its place and the commands that explain it; the audit is repeated as it was."""
    (foo / "model.py").write_text("def broken(:\n")
    options = ("--gate", "static", "--fail-on", "warn")
    assert _run("audit", "policy/Foo", *options).exit_code == ExitCode.FINDINGS
    package = _one("Foo")
    static = package["steps"]["static"]
    assert (package["verdict"], package["stage"], static["state"]) == ("red", "placeholders", "failed")
    parses = next(found for found in static["found"] if found["slug"] == "parses")
    assert (parses["outcome"], parses["path"], parses["line"]) == ("fail", "model.py", 1)
    assert package["next"][-1] == "xpl audit policy/Foo --fail-on warn"
    assert f"xpl explain {static['found'][0]['code']}" in package["next"]
    (foo / "model.py").write_text("fixed = True\n")
    assert _one("Foo")["verdict"] == "incomplete"
    assert _one("Foo")["steps"]["static"]["found"] == []


def test_green_needs_every_gate_with_the_real_model(filled: Path) -> None:
    """A stand-in is a shadow, not_run is no pass, and the last thing to do is to evaluate."""
    passed = [_gate(gate, Outcome.PASS) for gate in Gate]
    _audited(filled, *passed)
    package = _one("Foo")
    assert (package["verdict"], package["stage"]) == ("green", None)
    assert package["statement"] == "GREEN contract; conversions unproven (no native.py)"
    assert _run("status", "Foo").stdout.splitlines()[-3] == f"stands  {package['statement']}"
    assert package["next"] == ["xpl eval policy/Foo --env mujoco --episodes 10"]
    shadow = Choice(Profile.SHADOW, reason="the module torch is not installed here")
    _audited(filled, _gate(Gate.OFFLINE, Outcome.PASS, served=shadow))
    package = _one("Foo")
    assert (package["verdict"], package["steps"]["offline"]["state"]) == ("shadow", "partial")
    assert "torch" in package["steps"]["offline"]["detail"]
    assert package["next"] == ["xpl audit policy/Foo --profile full"]
    _audited(filled, *passed, _gate(Gate.MUJOCO, Outcome.NOT_RUN), options=("--set", "a=b c"))
    package = _one("Foo")
    assert (package["verdict"], package["stage"], package["steps"]["mujoco"]["state"]) == (
        "incomplete",
        "mujoco",
        "not_run",
    )
    assert package["next"][-1] == "xpl audit policy/Foo --set 'a=b c'"


def test_after_the_last_edit_comes_an_audit(foo: Path) -> None:
    """Every gate has passed, and the template's marks are still there."""
    _audited(foo, *(_gate(gate, Outcome.PASS) for gate in Gate))
    package = _one("Foo")
    assert (package["stage"], package["next"]) == ("placeholders", ["xpl audit policy/Foo"])
    assert package["verdict"] == "open"


def test_another_version_of_the_tool_has_to_look_again(filled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rules may be others."""
    monkeypatch.setattr(memory, "__version__", "0.0.1")
    _audited(filled, _gate(Gate.STATIC, Outcome.PASS))
    static = _one("Foo")["steps"]["static"]
    assert static["state"] == "stale"
    assert "0.0.1" in static["detail"]


def test_a_gate_that_was_not_started_leaves_what_was_known(filled: Path) -> None:
    """The static gate failed before it; what the offline gate had said of these files holds."""
    _audited(filled, _gate(Gate.OFFLINE, Outcome.PASS))
    folder = standing.memory_folder()
    assert folder is not None
    waiting = GateReport(Gate.OFFLINE, [], reason="the static gate did not pass")
    memory.remember(folder, filled, TargetReport(str(filled), "Foo", "policy", [waiting]), ())
    assert _one("Foo")["steps"]["offline"]["state"] == "done"


def test_a_record_that_cannot_be_read_is_none(filled: Path) -> None:
    """Half a file, or one of another shape; the next audit writes a new one."""
    _audited(filled, _gate(Gate.STATIC, Outcome.PASS))
    folder = standing.memory_folder()
    assert folder is not None
    (record,) = folder.iterdir()
    for content_ in ('{"gates": {"static"', "[]", '{"gates": {"static": {"outcome": "pass"}}}'):
        record.write_text(content_)
        assert _one("Foo")["steps"]["static"]["state"] == "open"
    _audited(filled, _gate(Gate.STATIC, Outcome.PASS))
    assert _one("Foo")["steps"]["static"]["state"] == "done"


# -- what comes before the gates ---------------------------------------------------------------------------------------


def test_nothing_of_the_adapter_is_run(foo: Path, workspace: Path) -> None:
    """Code that would leave a trace leaves none."""
    for name in ("model.py", "deploy.py", "__init__.py"):
        (foo / name).write_text(f"open({str(workspace / 'executed')!r}, 'w').close()\n")
    _status("Foo")
    assert sorted(path.name for path in workspace.iterdir()) == ["policy"]


def test_an_adapter_of_the_ecosystem_is_adopted_first(foo: Path) -> None:
    """It has no manifest."""
    (foo / "policy.yml").unlink()
    package = _one("Foo")
    assert (package["stage"], package["steps"]["manifest"]["state"]) == ("manifest", "open")
    assert package["next"][:2] == ["xpl adopt policy/Foo --dry-run", "xpl adopt policy/Foo"]


def test_a_broken_manifest_comes_first(foo: Path) -> None:
    """With the command that lists its problems."""
    (foo / "policy.yml").write_text("famly: vla\n")
    package = _one("Foo")
    assert (package["verdict"], package["stage"]) == ("red", "manifest")
    assert package["next"][0] == "xpl spec validate policy/Foo/policy.yml"


def test_environment_and_checkpoint_are_asked_for_as_declared(foo: Path, tmp_path: Path) -> None:
    """What is missing has its command; nothing is made."""
    weights = tmp_path / "weights.bin"
    weights.write_bytes(b"weights")
    manifest = (foo / "policy.yml").read_text()
    lines = [line for line in manifest.splitlines() if not line.startswith(("environment:", "checkpoints:"))]
    declared = {
        "environment": {"manager": "venv", "requirements": ["numpy"]},
        "checkpoints": [{"name": "base", "source": str(weights), "sha256": "0" * 64}],
    }
    told = [f"{key}: {json.dumps(value)}" for key, value in declared.items()]
    kept = [line for line in lines if not line.startswith(("  manager:", "  name:"))]
    (foo / "policy.yml").write_text("\n".join([*kept, *told]) + "\n")
    package = _one("Foo")
    assert [package["steps"][name]["state"] for name in ("manifest", "environment", "checkpoint")] == [
        "done",
        "open",
        "open",
    ]
    assert package["next"] == [
        "xpl install policy/Foo",
        "xpl checkpoint fetch policy/Foo base",
        "xpl audit policy/Foo",
    ]
    assert not (tmp_path / "checkpoints").exists()


# -- recorded evaluations ----------------------------------------------------------------------------------------------


def _played_by(foo: Path, folder: Path) -> None:
    """Let a run have been played by the files that an adapter has now."""
    head, *rest = (folder / records.FILE).read_text().splitlines(keepends=True)
    plan = json.loads(head)
    plan["policy"]["digest"] = fingerprints.package_digest(foo)
    (folder / records.FILE).write_text("".join([json.dumps(renamed(plan)) + "\n", *rest]))


def test_an_evaluation_that_was_cut_off_goes_on(filled: Path) -> None:
    """After green; one of other files, of another policy, or that cannot be read has no part in it."""
    _audited(filled, *(_gate(gate, Outcome.PASS) for gate in Gate))
    for name, policy, played in (
        ("done", "Foo", None),
        ("cut off", "Foo", 50),
        ("old", "Foo", 50),
        ("other", "Bar", 1),
    ):
        synthetic(Path("runs") / name, policy=policy, played=played)
        if name in {"done", "cut off"}:
            _played_by(filled, Path("runs") / name)
    Path("runs/broken").mkdir()
    Path("runs/broken/records.jsonl").write_text("{}\n")
    package = _one("Foo")
    states = {run["path"]: (run["state"], run["episodes"], run["unplayed"]) for run in package["runs"]}
    assert states == {
        "runs/done": ("complete", 80, 0),
        "runs/cut off": ("interrupted", 50, 30),
        "runs/old": ("other_files", 50, 30),
    }
    assert package["next"] == ["xpl eval policy/Foo --out 'runs/cut off' --resume"]
    assert any("runs/cut off: interrupted" in line for line in _run("status", "Foo").stdout.splitlines())
    (Path("runs/cut off") / records.FILE).unlink()
    assert _one("Foo")["next"] == ["xpl report runs/done"]


# -- several, and none -------------------------------------------------------------------------------------------------


def test_without_a_name_every_package_has_a_line(filled: Path, workspace: Path) -> None:
    """What is not settled comes first, with the command that tells more."""
    assert filled.is_dir()
    files = environment.render_env(environment.EnvAnswers(name="Bar", **environment.env_defaults()))
    adapter.write(files, workspace / "envs" / "Bar")
    _audited(filled, *(_gate(gate, Outcome.PASS) for gate in Gate))
    document = _status()
    assert [(one["path"], one["kind"]) for one in document["packages"]] == [
        ("policy/Foo", "policy"),
        ("envs/Bar", "env"),
    ]
    assert [step["name"] for step in document["packages"][1]["steps"]][-2:] == ["static", "offline"]
    assert document["next"] == ["xpl status envs/Bar"]
    lines = _run("status").stdout.splitlines()
    assert [line.split()[:2] for line in lines[:2]] == [["INCOMPLETE", "envs/Bar"], ["GREEN", "policy/Foo"]]


def test_the_folder_one_stands_in_is_meant(filled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths are relative to it."""
    monkeypatch.chdir(filled)
    package = _one()
    assert (package["path"], package["name"], package["next"]) == (".", "Foo", ["xpl audit ."])


def test_where_there_is_no_package_that_is_said() -> None:
    """With the command that starts one."""
    with pytest.raises(NotFoundError, match="no package below policy/ and envs/") as caught:
        _run("status")
    assert "xpl new-policy" in str(caught.value.hint)


def test_people_read_a_line_for_each_step(foo: Path) -> None:
    """Then where it stands, then what comes next."""
    assert foo.is_dir()
    lines = _run("status", "Foo").stdout.splitlines()
    assert lines[0].split() == ["Foo", "policy/Foo"]
    assert lines[-3:] == ["stands  INCOMPLETE at placeholders", "next", "  xpl audit policy/Foo"]


def test_our_own_packages_have_a_standing() -> None:
    """Every policy and environment that comes with the tool."""
    manifests = tracked("policy/*/policy.yml", "envs/*/env.yml")
    assert manifests
    for manifest in manifests:
        assert _one(str(manifest.parent))["steps"]["manifest"]["state"] == "done"


def test_gates_of_environments_are_those_of_their_rules() -> None:
    """A gate without any rule for environments is no step of theirs."""
    rules = [entry for entry in registry.entries() if entry.target == "env"]
    assert {gate for gate in Gate if any(entry.runs_in(gate) for entry in rules)} == set(GATES["env"])
