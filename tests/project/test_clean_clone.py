"""What commands leave in a clone is ignored: `git status` stays clean."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.support.checkout import ROOT
from xpl_cli.standard import spec

LEFT = [
    *(f"{room}/NAME/{name}" for room in ("envs", "policy") for name in (".venv", ".venv-0123456789ab", ".conda")),
    *(f"policy/NAME/{name}" for name in (spec.data("conventions")["checkpoint"]["directory"], "data", "logs")),
    *("demos", "model-io-show", "results", "benchmarks/demos", "NAME.xpl.zip"),
    *(f"{folder}/MUJOCO_LOG.TXT" for folder in (".", "envs/mujoco", "policy/NAME")),
    "xpl/__pycache__",
]
"""What `xpl install`, `train`, `record`, `eval`, `model_io show`, benchmarks, MuJoCo and Python leave."""


@pytest.mark.parametrize("kind", ["folder", "file", "link"])
def test_what_commands_leave_is_ignored(kind: str, tmp_path: Path) -> None:
    """Environments and checkpoints may be links to a larger disk."""
    begin = ["git", "init", "-q", str(tmp_path)]
    subprocess.run(begin, check=True)
    (tmp_path / ".gitignore").write_bytes((ROOT / ".gitignore").read_bytes())
    for path in (tmp_path / name.replace("NAME", "some") for name in LEFT):
        path.parent.mkdir(parents=True, exist_ok=True)
        if kind == "folder" or path.name == "__pycache__":  # which Python makes as a folder
            path.mkdir()
            (path / "file").touch()
        elif kind == "file":
            path.touch()
        else:
            path.symlink_to(ROOT)
    told = ["git", "status", "--porcelain", "--untracked-files=all"]
    done = subprocess.run(told, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "?? .gitignore\n"
