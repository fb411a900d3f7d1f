"""`xpl update`: a package gets what its template changed since, and keeps what its author wrote."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.support.checkout import copy
from tests.support.commands import Ended, xpl
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics.errors import UserError
from xpl_cli.scaffold import adapter as scaffold
from xpl_cli.scaffold import environment, lock, template
from xpl_cli.scaffold import update as updating
from xpl_cli.scaffold.answers import AdapterAnswers

GIT = shutil.which("git")


@pytest.fixture
def templates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of `templates/` that takes the place of ours, and may be changed."""
    copy(tmp_path / "content", "templates/**")
    usual = template.content_folder
    monkeypatch.setattr(
        template, "content_folder", lambda name: tmp_path / "content" / name if name == "templates" else usual(name)
    )
    return tmp_path / "content" / "templates"


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """Return an adapter as it is scaffolded, outside of any repository."""
    scaffold.write(_render(), tmp_path / "Foo")
    return tmp_path / "Foo"


def _render(**changes: Any) -> scaffold.Files:
    return scaffold.render(AdapterAnswers(**{"name": "Foo", **scaffold.defaults(), **changes}))


def _tree(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _apply(folder: Path) -> updating.UpdatePlan:
    plan = updating.plan(folder)
    updating.apply(plan)
    return plan


def _edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def _change(templates: Path) -> None:
    """Let the template of adapters change a file of each role, add one, and drop one."""
    files = templates / "policy" / "files"
    _edit(files / ".gitignore.jinja", "/.venv*", "/.venv/")
    _edit(files / "install.sh.jinja", "{%", "# a newer one\n{%")
    _edit(files / "policy.yml.jinja", "deterministic: true #", "deterministic: false #")
    (files / "setup.cfg.jinja").write_text("[{{ name }}]\n")
    (files / "__init__.py.jinja").unlink()


def _xpl(*arguments: str, cwd: Path) -> Ended:
    return xpl("update", *arguments, folder=cwd)


def _as_of_an_older_template(folder: Path) -> None:
    """Let a package have come from a template that said less in two of its files, which nobody edited since."""
    base = lock.read_rendered(folder)
    for name, line in ((".gitignore", b"/logs\n"), ("deploy.py", b"    Imports neither")):
        base[name] = base[name].replace(line, b"")
        (folder / name).write_bytes(base[name])
    (folder / lock.RENDERED).write_bytes(lock.rendered_text(base))


# -- what comes of it --------------------------------------------------------------------------------------------------


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "answers",
    [
        {},
        {"eval_only": True, "action_type": "ee", "chunk": 1},
        {"embodiment": "franka_single", "python": "3.10", "reference": True},
        {"embodiment": "tianji_marvin_wuji", "kind": "torch", "block": False},
    ],
    ids=str,
)
def test_an_untouched_adapter_becomes_what_is_scaffolded_today(
    answers: dict[str, Any], templates: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "Foo"
    scaffold.write(_render(**answers), folder)
    assert updating.plan(folder).steps == ()
    _change(templates)
    plan = _apply(folder)
    actions = {step.name: step.action for step in plan.steps if not step.name.startswith(".xpl/")}
    assert actions == {
        ".gitignore": "updated",
        "__init__.py": "removed",
        "install.sh": "updated",
        "policy.yml": "updated",
        "setup.cfg": "added",
    }
    assert _tree(folder) == _render(**answers)
    assert os.access(folder / "install.sh", os.X_OK)
    assert updating.plan(folder).steps == ()


def test_what_the_author_wrote_stays(adapter: Path, templates: Path) -> None:
    _edit(adapter / ".gitignore", "/data\n", "/recordings\n")
    _edit(adapter / "policy.yml", "family: other", "family: act")
    _edit(adapter / "deploy.yml", "eval_batch: false", "eval_batch: true")
    _edit(adapter / "__init__.py", '"""', '"""Mine. ')
    (adapter / "net.py").write_text("LAYERS = 3\n")
    (adapter / "install.sh").unlink()
    before = _tree(adapter)
    _change(templates)
    plan = _apply(adapter)
    assert not plan.conflicts
    after = _tree(adapter)
    gitignore, manifest = after[".gitignore"].decode(), after["policy.yml"].decode()
    assert "/recordings" in gitignore
    assert "/.venv/\n" in gitignore
    assert "family: act" in manifest
    assert "deterministic: false" in manifest
    for name in ("net.py", "deploy.yml", "__init__.py"):
        assert after[name] == before[name]
    assert "install.sh" not in after
    notes = {step.name: step.action for step in plan.steps if step.note}
    assert notes == {"__init__.py": "kept", "install.sh": "kept"}
    assert updating.plan(adapter).steps == ()


def test_files_that_the_author_took_over_are_left_alone(adapter: Path, templates: Path) -> None:
    _edit(adapter / lock.PATH, "free: []", "free: [install.sh, own.sh]")
    (adapter / "install.sh").write_text("mine\n")
    base = lock.read_rendered(adapter)["install.sh"]
    _change(templates)
    _apply(adapter)
    assert (adapter / "install.sh").read_text() == "mine\n"
    package_lock = lock.read(adapter)
    assert package_lock is not None
    assert package_lock.free == ("install.sh", "own.sh")
    assert "install.sh" not in package_lock.generated
    assert lock.read_rendered(adapter)["install.sh"] == base


def test_a_link_is_left_alone(adapter: Path, templates: Path) -> None:
    shared = adapter.parent / "shared"
    (adapter / ".gitignore").rename(shared)
    (adapter / ".gitignore").symlink_to(shared)
    before = shared.read_bytes()
    _change(templates)
    plan = _apply(adapter)
    assert (adapter / ".gitignore").is_symlink()
    assert shared.read_bytes() == before
    assert next(step for step in plan.steps if step.name == ".gitignore").action == "kept"


@pytest.mark.parametrize(
    ("file", "text", "told"),
    [
        (lock.PATH, None, "its template is unknown"),
        (lock.PATH, "nothing: here\n", "is damaged"),
        (lock.PATH, "template: arm\nanswers: {}\n", "must be one of policy, env"),
        (lock.PATH, "template: policy\nanswers: {name: 3}\n", "answers are not those"),
        (lock.RENDERED, None, "is damaged"),
        (lock.RENDERED, "[]", "is damaged"),
    ],
)
def test_a_package_that_does_not_tell_what_it_came_from_is_refused(
    file: str, text: str | None, told: str, adapter: Path
) -> None:
    """Without what was rendered nobody could tell the author's lines from the template's."""
    if text is None:
        (adapter / file).unlink()
    else:
        (adapter / file).write_text(text)
    with pytest.raises(UserError, match=told):
        updating.plan(adapter)


# -- never half --------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(3)
@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device", "somewhere")], ids=repr)
@pytest.mark.parametrize("place", range(7))
def test_an_update_that_fails_leaves_the_package_as_it_was(
    place: int, error: BaseException, adapter: Path, templates: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (adapter / "install.sh").chmod(0o700)
    before, written = _tree(adapter), []
    _change(templates)
    write = updating._write_content

    def failing(path: Path, content: bytes | None, mode: int | None = None) -> None:
        written.append(path)
        if len(written) == place + 1:
            raise error
        write(path, content, mode)

    monkeypatch.setattr(updating, "_write_content", failing)
    plan = updating.plan(adapter)
    assert len(plan.changes) == 7
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else UserError):
        updating.apply(plan)
    assert _tree(adapter) == before
    assert (adapter / "install.sh").stat().st_mode & 0o777 == 0o700


def test_an_update_that_was_killed_is_begun_again(adapter: Path, templates: Path, tmp_path: Path) -> None:
    """A process that is killed can clear nothing up; the next run comes to what the whole one would have come to."""
    _edit(adapter / "policy.yml", "family: other", "family: act")
    whole = tmp_path / "whole" / "Foo"
    shutil.copytree(adapter, whole)
    _change(templates)
    _apply(whole)
    plan = updating.plan(adapter)
    for written in range(len(plan.changes)):
        folder = tmp_path / str(written) / "Foo"
        shutil.copytree(adapter, folder)
        for step in plan.changes[:written]:
            updating._write_content(folder / step.name, step.after)
        _apply(folder)
        assert _tree(folder) == _tree(whole)


def test_a_file_that_changes_meanwhile_is_not_overwritten(adapter: Path, templates: Path) -> None:
    _change(templates)
    plan = updating.plan(adapter)
    (adapter / "policy.yml").write_text("spec: v1\n")
    before = _tree(adapter)
    with pytest.raises(UserError, match="changed meanwhile"):
        updating.apply(plan)
    assert _tree(adapter) == before


# -- the command -------------------------------------------------------------------------------------------------------


def test_the_command_tells_what_it_does(adapter: Path) -> None:
    _as_of_an_older_template(adapter)
    before = _tree(adapter)
    dry = _xpl("Foo", "--dry-run", "--json", cwd=adapter.parent)
    assert (dry.code, _tree(adapter)) == (0, before)
    completed = _xpl("Foo", "--json", cwd=adapter.parent)
    answer, foretold = json.loads(completed.stdout), json.loads(dry.stdout)
    assert completed.code == 0
    assert (answer["state"], foretold["state"]) == ("updated", "would be updated")
    assert answer["files"] == foretold["files"]
    assert {"name": ".gitignore", "action": "updated", "conflicts": 0, "note": None} in answer["files"]
    assert _tree(adapter) == _render()
    again = _xpl("Foo", cwd=adapter.parent)
    assert (again.code, again.stdout) == (0, "Foo: is as its template has it, nothing to do\n")


def test_a_conflict_is_exit_code_1(adapter: Path) -> None:
    _as_of_an_older_template(adapter)
    with (adapter / ".gitignore").open("a") as stream:
        stream.write("/mine/\n")
    _edit(adapter / ".gitignore", "/data\n", "/data here\n")
    for options in (["--dry-run"], []):
        completed = _xpl("Foo", *options, cwd=adapter.parent)
        assert completed.code == 1, completed.stderr
        assert "conflict  .gitignore (1 to decide)" in completed.stdout


@pytest.mark.skipif(GIT is None, reason="git is not installed")
def test_changes_that_git_has_not_recorded_are_protected(adapter: Path) -> None:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=A", "-c", "user.email=a@example.org"]
        subprocess.run([str(GIT), "-C", str(adapter.parent), *identity, *arguments], check=True, capture_output=True)

    _as_of_an_older_template(adapter)
    git("init", "--quiet")
    refused = _xpl("Foo", cwd=adapter.parent)
    assert refused.code == 2
    assert "Foo has changes that git has not recorded" in refused.stderr
    git("add", "--all")
    git("commit", "--quiet", "--message", "scaffold")
    (adapter.parent / "elsewhere.txt").write_text("not of the package\n")
    _edit(adapter / "README.md", "# Foo", "# My Foo")
    refused = _xpl("Foo", cwd=adapter.parent)
    assert (refused.code, refused.stdout) == (2, "")
    assert "git has not recorded: Foo/README.md" in refused.stderr
    assert _xpl("Foo", "--force", cwd=adapter.parent).code == 0


@pytest.mark.parametrize(("arguments", "code"), [(["Nothing"], 3), (["demo_policy"], 2)])
def test_exit_codes(arguments: list[str], code: int, adapter: Path) -> None:
    completed = _xpl(*arguments, cwd=adapter.parent)
    assert (completed.code, completed.stdout) == (code, "")


# -- what the audit says -----------------------------------------------------------------------------------------------


def test_an_edited_generated_file_is_brought_back_by_the_fix(adapter: Path) -> None:
    from xpl_cli.audit.engine.fixes import plan

    before = _tree(adapter)
    _edit(adapter / "eval.sh", "set -euo pipefail", "set -eu")
    (adapter / ".xpl" / "policy.schema.json").write_text("{}\n")
    report = engine.audit(adapter, "policy", AuditOptions(gates=(Gate.STATIC,), names=("generated-files",)))
    assert report.gates[0].results[0].outcome is Outcome.WARN
    plan(adapter, report).apply()
    assert _tree(adapter) == before
    assert os.access(adapter / "eval.sh", os.X_OK)


# -- environments ------------------------------------------------------------------------------------------------------


def test_an_environment_is_brought_along(tmp_path: Path, templates: Path) -> None:
    answers = environment.EnvAnswers(name="Foo", **environment.env_defaults())
    folder = tmp_path / "Foo"
    scaffold.write(environment.render_env(answers), folder)
    _edit(folder / "env.yml", "max_steps: 100", "max_steps: 120 # mine")
    _edit(templates / "env" / "files" / "env.yml.jinja", "control_frequency: 25", "control_frequency: 20")
    completed = _apply(folder)
    assert {step.name: step.action for step in completed.steps} == {"env.yml": "merged", lock.RENDERED: "updated"}
    text = (folder / "env.yml").read_text()
    assert "max_steps: 120 # mine" in text
    assert "control_frequency: 20" in text
    assert updating.plan(folder).steps == ()
