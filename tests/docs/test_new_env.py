"""The examples of docs/new-environment.md work."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
import yaml

from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode
from xpl_cli.standard.validate import validate

PAGE = (ROOT / "docs" / "new-environment.md").read_text(encoding="utf-8")


def _blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which every command of the page has run, line by line."""
    folder = tmp_path_factory.mktemp("workspace")
    for line in filter(None, "\n".join(_blocks("console")).splitlines()):
        done = xpl(*shlex.split(line)[1:], cwd=folder)
        assert done.returncode == ExitCode.CLEAN, (line, done.stdout, done.stderr)
    return folder


@pytest.mark.slow
def test_every_command_of_the_page_runs(workspace: Path) -> None:
    assert (workspace / "scene.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_simulator_of_the_page_passes_the_audit(workspace: Path) -> None:
    folder = workspace / "envs" / "Table"
    (code,) = _blocks("python")
    (folder / "episode.py").write_text(code, encoding="utf-8")
    manifest = yaml.safe_load((folder / "env.yml").read_text(encoding="utf-8"))
    match = re.search(r"here `(action_types: .*?)`, `(cameras: .*?)` and `(privileged: .*?)`", PAGE)
    assert match is not None
    for entry in match.groups():
        manifest.update(yaml.safe_load(entry))
    (folder / "env.yml").write_text(json.dumps(manifest), encoding="utf-8")
    done = xpl("audit", "envs/Table", "--no-cache", "--json", cwd=workspace)
    assert done.returncode == ExitCode.CLEAN, done.stdout


def test_the_manifest_of_the_page_is_valid(tmp_path: Path) -> None:
    first = next(line for line in "\n".join(_blocks("console")).splitlines() if "new-env" in line)
    assert xpl(*shlex.split(first)[1:], cwd=tmp_path).returncode == ExitCode.CLEAN
    manifest = yaml.safe_load((tmp_path / "envs" / "Table" / "env.yml").read_text(encoding="utf-8"))
    (example,) = _blocks("yaml")
    assert validate(manifest | yaml.safe_load(example), "env") == []
