"""`action.yml` and `.pre-commit-hooks.yaml`: what they run, run here as GitHub's runner and pre-commit run it."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support import forked
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode

ACTION: dict[str, Any] = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
INSTALL, AUDIT, UPLOAD = ACTION["runs"]["steps"]
(HOOK,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))

PLANTED = ("json.py", "pip/__init__.py", "sitecustomize.py", "typing.py", "usercustomize.py", "venv.py", "yaml.py")
"""Modules that a stranger puts where the action runs, in the hope that Python imports them."""


@dataclass(frozen=True)
class Done:
    """A step that has run.

    Attributes:
        code: its exit code.
        log: all that it printed.
        outputs: the step's outputs.
        summary: its part of the summary page.
    """

    code: int
    log: str
    outputs: dict[str, str]
    summary: str

    @property
    def commands(self) -> list[str]:
        """The lines that the runner takes for workflow commands."""
        found: list[str] = []
        resume = ""
        for line in self.log.splitlines():
            if resume:
                resume = "" if line == resume else resume
            elif line.startswith("::stop-commands::"):
                resume = f"::{line.removeprefix('::stop-commands::')}::"
            elif line.startswith("::"):
                found.append(line)
        assert not resume, "commands are read again at the end"
        return found


class Runner:
    """Runs steps of the action as GitHub's runner does, with an environment that holds nothing else.

    Attributes:
        temp: the runner's folder for temporary files.
    """

    def __init__(self, temp: Path) -> None:
        self.temp = temp
        self.temp.mkdir()
        self._runs = 0

    def run(
        self,
        step: dict[str, Any],
        workspace: Path,
        *,
        event: dict[str, Any] | None = None,
        env: dict[str, str] | None = None,
        **inputs: str,
    ) -> Done:
        """Run a step in a workspace, with inputs named as in `action.yml` but for underscores."""
        assert step["shell"] == "bash"
        self._runs += 1
        files = {name: self.temp / f"{name.lower()}-{self._runs}" for name in ("GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY")}
        for file in files.values():
            file.touch()
        script = self.temp / f"script-{self._runs}.sh"
        script.write_text(step["run"], encoding="utf-8")
        given = {name: str(entry["default"]) for name, entry in ACTION["inputs"].items()}
        given |= {name.replace("_", "-"): value for name, value in inputs.items()}
        assert set(given) == set(ACTION["inputs"])
        context = {"inputs": given, "github": {"event": event or {}}}
        command = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", str(script)]
        done = subprocess.run(
            command,
            cwd=workspace,
            env={
                "PATH": os.environ["PATH"],
                "HOME": str(self.temp),
                "CI": "true",
                "GITHUB_ACTIONS": "true",
                "GITHUB_ACTION_PATH": str(ROOT),
                "GITHUB_WORKSPACE": str(workspace),
                "RUNNER_TEMP": str(self.temp),
                **{name: str(file) for name, file in files.items()},
                **{name: _evaluated(text, context) for name, text in step.get("env", {}).items()},
                **(env or {}),
            },
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        outputs = _outputs(files["GITHUB_OUTPUT"].read_text(encoding="utf-8"))
        return Done(done.returncode, done.stdout, outputs, files["GITHUB_STEP_SUMMARY"].read_text(encoding="utf-8"))


def _evaluated(text: str, context: dict[str, Any]) -> str:
    """Return what an expression such as `${{ inputs.a || github.event.b }}` is worth; others are not understood."""
    found = re.fullmatch(r"\$\{\{ (.*) \}\}", text)
    if found is None:
        assert "${{" not in text
        return text
    for term in found.group(1).split(" || "):
        assert re.fullmatch(r"[a-z_.-]+", term), term
        value: Any = context
        for key in term.split("."):
            value = value.get(key, {})
        if value:
            return str(value)
    return ""


def _outputs(text: str) -> dict[str, str]:
    found: dict[str, str] = {}
    lines = iter(text.splitlines())
    for line in lines:
        name, one_line, value = line.partition("=")
        if not one_line:
            name, _, end = line.partition("<<")
            value = "\n".join(iter(partial(next, lines), end))
        found[name] = value
    return found


def _git(*arguments: str, cwd: Path) -> str:
    who = ["-c", "user.name=A", "-c", "user.email=a@example.com", "-c", "init.defaultBranch=main"]
    command = ["git", *who, *arguments]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Runner:
    """A runner on which the action's first step has installed the tool, in a workspace full of traps."""
    runner = Runner(tmp_path_factory.mktemp("a runner") / "temp")
    # Stands in for the index: what the tool depends on lies in this environment already.
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = runner.temp / "xpl-audit/venv/lib" / version / "site-packages"
    packages.mkdir(parents=True)
    (packages / "index.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    workspace = tmp_path_factory.mktemp("stranger")
    _plant(workspace)
    offline = {"PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0", "PIP_CONFIG_FILE": os.devnull}
    done = runner.run(INSTALL, workspace, env=offline, python=sys.executable)
    assert done.code == 0, done.log
    assert not (workspace / "executed").exists()
    return runner


def _plant(workspace: Path) -> None:
    """Plant modules that note that they were executed."""
    for name in PLANTED:
        (workspace / name).parent.mkdir(exist_ok=True)
        (workspace / name).write_text(f"open({str(workspace / 'executed')!r}, 'w')\n")


@pytest.fixture(scope="module")
def scaffold(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A repository with two packages, Foo and Bar, and traps beside them, committed."""
    folder = tmp_path_factory.mktemp("repository")
    for name in ("Foo", "Bar"):
        assert xpl("new-policy", name, cwd=folder).returncode == ExitCode.CLEAN
    _plant(folder)
    _git("init", "--quiet", cwd=folder)
    _git("add", ".", cwd=folder)
    _git("commit", "--quiet", "-m", "base", cwd=folder)
    return folder


@pytest.fixture
def workspace(scaffold: Path, tmp_path: Path) -> Path:
    _git("clone", "--quiet", str(scaffold), str(tmp_path / "work space"), cwd=tmp_path)
    return tmp_path / "work space"


def _break(package: Path) -> None:
    with (package / "model.py").open("a", encoding="utf-8") as model:
        model.write(
            "\n    def reset(self):\n        try:\n            super().reset()\n        except:\n            pass\n"
        )


# --- The file ---------------------------------------------------------------------------------------------------------


def test_nothing_from_outside_is_text_of_a_script() -> None:
    for step in (INSTALL, AUDIT):
        assert "${{" not in step["run"]
        assert "eval" not in step["run"].split()
    # What the tool starts is as safe as the tool is.
    assert AUDIT["env"]["PYTHONSAFEPATH"] == "1"


def test_every_input_reaches_a_step_and_every_variable_is_read() -> None:
    text = json.dumps(ACTION["runs"])
    assert [name for name in ACTION["inputs"] if f"inputs.{name}" not in text] == []
    for step in (INSTALL, AUDIT):
        unread = [name for name in step["env"] if name.startswith("XPL_") and f"${name}" not in step["run"]]
        assert [name for name in unread if f"${{{name}" not in step["run"]] == []


def test_upload_is_asked_for_and_allowed() -> None:
    assert ACTION["inputs"]["upload-sarif"]["default"] == "false"
    for guard in ("inputs.upload-sarif == 'true'", "head.repo.fork", "steps.audit.outputs.sarif != ''", "!cancelled()"):
        assert guard in UPLOAD["if"]
    assert not re.search(
        r"secrets\.|token", (ROOT / "action.yml").read_text(encoding="utf-8").replace("whose token", "")
    )


# --- Running it -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("upload", ["false", "true"])
def test_a_clean_package_passes(upload: str, runner: Runner, workspace: Path) -> None:
    """A file to upload lies outside the workspace; nothing of that is executed, and nothing is left there."""
    done = runner.run(AUDIT, workspace, paths="policy/Foo", upload_sarif=upload)
    assert done.code == 0, done.log
    assert done.outputs["exit-code"] == "0"
    assert "Foo" in done.summary
    assert not [line for line in done.commands if line.startswith("::error")]
    assert upload == "false" or Path(done.outputs["sarif"]).is_relative_to(runner.temp)
    assert _git("status", "--porcelain", cwd=workspace) == ""


@pytest.mark.slow
def test_findings_fail_annotate_and_are_written(runner: Runner, workspace: Path) -> None:
    _break(workspace / "policy/Foo")
    done = runner.run(AUDIT, workspace, paths="policy/Foo\npolicy/Bar\n", sarif_file="out put/audit.sarif")
    assert done.code == ExitCode.FINDINGS, done.log
    assert done.outputs == {"exit-code": "1", "sarif": "out put/audit.sarif"}
    errors = [line for line in done.commands if line.startswith("::error")]
    assert errors
    assert all("file=policy/Foo/model.py,line=" in line for line in errors)
    assert "XPL116" in done.summary
    sarif = json.loads((workspace / "out put/audit.sarif").read_text(encoding="utf-8"))
    assert sarif["version"] == "2.1.0"


@pytest.mark.slow
def test_rules_are_chosen_by_code(runner: Runner, workspace: Path) -> None:
    _break(workspace / "policy/Foo")
    done = runner.run(AUDIT, workspace, paths="policy/Foo", ignore="XPL116, XPL131\nreset-incomplete")
    assert done.code == 0, done.log


HOSTILE = (
    "$(touch executed)",
    "`touch executed`",
    "; touch executed #",
    "' ; touch executed ; '",
    '" ; touch executed ; "',
    "x\n; touch executed",
    "x && touch executed",
    "--output=executed",
    "--all",
    "*",
    "::set-output name=x::y",
    "a[$(touch executed)]",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("paths", value) for value in (HOSTILE[0], HOSTILE[3], "--all", "*")),
        *((name, "\n".join(HOSTILE)) for name in ("paths", "gates", "select", "fail_on")),
    ],
)
def test_hostile_inputs_are_words(runner: Runner, workspace: Path, name: str, value: str) -> None:
    """They name nothing that exists, so the audit fails; nothing is executed, nothing becomes an option."""
    before = _git("status", "--porcelain", cwd=workspace)
    inputs: dict[str, Any] = {"paths": "policy/Foo", name: value}
    done = runner.run(AUDIT, workspace, **inputs)
    assert done.code in {ExitCode.USAGE, ExitCode.NOT_FOUND}, done.log
    assert _git("status", "--porcelain", cwd=workspace) == before
    assert [line for line in done.commands if not line.startswith(("::error", "::notice"))] == []


@pytest.mark.slow
@pytest.mark.parametrize("value", [HOSTILE[0], "--output=executed"])
def test_a_hostile_base_is_a_name(runner: Runner, workspace: Path, value: str) -> None:
    """What to compare with may be anything; then everything is audited."""
    done = runner.run(AUDIT, workspace, changed_since=value)
    assert any(line.startswith("::notice") and "everything is audited" in line for line in done.commands), done.log
    assert _git("status", "--porcelain", cwd=workspace) == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["-x", 'a b\'s "$(touch executed)" ä;&'])
def test_a_package_of_any_name_is_audited(runner: Runner, workspace: Path, name: str) -> None:
    """One line is one path; the finding is about that file."""
    package = workspace / "policy" / name
    (workspace / "policy/Foo").rename(package)
    _break(package)
    done = runner.run(AUDIT, workspace, paths=f"policy/{name}", sarif_file="$(touch executed).sarif")
    assert done.code == ExitCode.FINDINGS, done.log
    assert any(f"file=policy/{name}/model.py," in line for line in done.commands)
    assert not (workspace / "executed").exists()
    assert (workspace / "$(touch executed).sarif").is_file()


@pytest.mark.slow
def test_what_packages_say_is_no_command(runner: Runner, workspace: Path) -> None:
    forged = "::add-path::/tmp/evil"
    (workspace / f"policy/Foo/{forged[2:8]}.py").write_text("")
    (workspace / "policy/Foo/model.py").write_text(f"x = '''\n{forged}\n'''\ndef (\n{forged}\n", encoding="utf-8")
    done = runner.run(AUDIT, workspace, paths="policy/Foo")
    assert done.code != 0
    assert all(line.startswith(("::error", "::warning", "::notice")) for line in done.commands)
    marks = [line for line in done.log.splitlines() if line.startswith("::stop-commands::")]
    again = runner.run(AUDIT, workspace, paths="policy/Foo")
    assert marks[0] not in again.log, "the mark cannot be known beforehand"


@pytest.mark.slow
def test_an_audit_that_cannot_start_says_so(runner: Runner, workspace: Path) -> None:
    done = runner.run(AUDIT, workspace, paths="policy/Nowhere")
    assert done.code == ExitCode.NOT_FOUND
    assert done.commands[-1].startswith("::error title=xpl audit::the audit ended with code 3")


@pytest.mark.slow
def test_an_old_python_is_refused(runner: Runner, workspace: Path, tmp_path: Path) -> None:
    old = tmp_path / "python"
    old.write_text("#!/bin/sh\nexit 1\n")
    old.chmod(0o755)
    done = runner.run(INSTALL, workspace, python=str(old))
    assert done.code == ExitCode.USAGE
    assert "3.11" in done.commands[0]


# --- Pull requests ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_pull_request_audits_what_it_changes(runner: Runner, scaffold: Path, workspace: Path, tmp_path: Path) -> None:
    """From a clone of depth 1, as the checkout of a fork is, the base is fetched; other packages are left alone."""
    base = _git("rev-parse", "HEAD", cwd=scaffold)
    _break(workspace / "policy/Bar")
    _git("commit", "--quiet", "-am", "change", cwd=workspace)
    _git("config", "uploadpack.allowAnySHA1InWant", "true", cwd=workspace)
    shallow = tmp_path / "shallow"
    _git("clone", "--quiet", "--depth=1", workspace.as_uri(), str(shallow), cwd=tmp_path)
    done = runner.run(AUDIT, shallow, event={"pull_request": {"base": {"sha": base}}})
    assert done.code == ExitCode.FINDINGS, done.log
    assert "Bar" in done.summary
    assert "Foo" not in done.summary


@pytest.mark.slow
@pytest.mark.parametrize("is_pull_request", [True, False])
def test_what_is_audited_where_no_package_changed(
    is_pull_request: bool, runner: Runner, scaffold: Path, workspace: Path
) -> None:
    """Nothing to audit is no failure of a pull request; a push says nothing of a base, and everything is audited."""
    base = _git("rev-parse", "HEAD", cwd=scaffold)
    (workspace / "README.md").write_text("changed\n")
    _git("add", ".", cwd=workspace)
    _git("commit", "--quiet", "-m", "change", cwd=workspace)
    done = runner.run(AUDIT, workspace, event={"pull_request": {"base": {"sha": base}}} if is_pull_request else None)
    assert done.code == 0, done.log
    assert [name in done.summary for name in ("Foo", "Bar")] == [not is_pull_request] * 2


# --- pre-commit -------------------------------------------------------------------------------------------------------


def _hook(*files: str, cwd: Path, args: list[str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run the hook as pre-commit does: entry, arguments, files."""
    program, *entry = shlex.split(HOOK["entry"])
    assert program == "xpl"
    # As of an installed command, the working directory is no place of modules.
    return forked.run(*entry, *(HOOK["args"] if args is None else args), *files, cwd=cwd)


def test_the_hook_audits_the_packages_of_its_files(workspace: Path) -> None:
    _break(workspace / "policy/Foo")
    assert _hook("policy/Bar/model.py", "policy/Bar/deploy.yml", "README.md", cwd=workspace).returncode == 0
    done = _hook("policy/Bar/model.py", "policy/Foo/README.md", cwd=workspace)
    assert done.returncode == ExitCode.FINDINGS, done.stdout + done.stderr
    assert "policy/Foo/model.py" in done.stdout


def test_the_hook_passes_over_other_files(workspace: Path) -> None:
    (workspace / "tools").mkdir()
    (workspace / "tools/model.py").write_text("x = 1\n")
    done = _hook("tools/model.py", "README.md", "policy/notes.md", cwd=workspace)
    assert (done.returncode, done.stdout) == (0, "")


def test_the_hook_sees_the_package_around_a_vendored_one(workspace: Path) -> None:
    inner = workspace / "policy/Foo/upstream/policy/Inner"
    inner.mkdir(parents=True)
    (inner / "model.py").write_text("def (\n")
    done = _hook("policy/Foo/upstream/policy/Inner/model.py", cwd=workspace)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["--help", "-x", "$(touch executed)", "a b", "it's"])
def test_the_hook_takes_files_of_any_name(workspace: Path, name: str) -> None:
    _break(workspace / "policy/Foo")
    (workspace / "policy/Foo" / name).write_text("")
    assert _hook(name, f"policy/Foo/{name}", cwd=workspace).returncode == ExitCode.FINDINGS
    assert not (workspace / "executed").exists()


def test_the_hook_takes_options_before_the_mark(workspace: Path) -> None:
    _break(workspace / "policy/Foo")
    options = ["--ignore=XPL116", "--ignore=XPL131", "--ignore=reset-incomplete", "--"]
    done = _hook("policy/Foo/model.py", cwd=workspace, args=options)
    assert done.returncode == 0, done.stdout + done.stderr
