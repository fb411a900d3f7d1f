"""What commands leave in a clone is ignored: `git status` stays clean."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.support.places import ROOT
from xpl_cli.standard import spec

LEFT = [
    *(f"{room}/NAME/{name}" for room in ("envs", "policy") for name in (".venv", ".venv-0123456789ab", ".conda")),
    *(f"policy/NAME/{name}" for name in (spec.data("conventions")["checkpoint"]["directory"], "data", "logs")),
    *("demos", "native-show", "results", "benchmarks/demos", "NAME.xpl.zip"),
    *(f"{folder}/MUJOCO_LOG.TXT" for folder in (".", "envs/mujoco", "policy/NAME")),
    "xpl/__pycache__",
]
"""What `xpl install`, `train`, `record`, `eval`, `native show`, benchmarks, MuJoCo and Python leave."""


@pytest.mark.parametrize("name", LEFT)
def test_what_commands_leave_is_ignored(name: str, tmp_path: Path) -> None:
    """As a folder, as a file, and as a link: environments and checkpoints may be links to a larger disk."""
    begin = ["git", "init", "-q", str(tmp_path)]
    subprocess.run(begin, check=True)
    (tmp_path / ".gitignore").write_bytes((ROOT / ".gitignore").read_bytes())
    path = tmp_path / name.replace("NAME", "some")
    path.parent.mkdir(parents=True, exist_ok=True)
    told = ["git", "status", "--porcelain", "--untracked-files=all"]
    path.mkdir()
    (path / "file").touch()
    _is_clean(told, tmp_path)
    (path / "file").unlink()
    path.rmdir()
    if path.name == "__pycache__":
        return  # which Python makes as a folder
    for make in (path.touch, lambda: path.symlink_to(ROOT)):
        make()
        _is_clean(told, tmp_path)
        path.unlink()


def _is_clean(told: list[str], folder: Path) -> None:
    done = subprocess.run(told, cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout == "?? .gitignore\n"
