"""A skill tells how to serve in the background, and how to end that: done to the letter, in a shell for each piece."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

from tests.support import pages
from tests.support.checkout import ROOT
from xpl_cli.isolation import processes

if TYPE_CHECKING:
    from pathlib import Path

PAGE = ROOT / ".agents/skills/xpl-debug-policy/references/experiments.md"
POLICY = ROOT / "policy/demo_policy"


def test_a_server_in_the_background_is_asked_and_ended(tmp_path: Path) -> None:
    start, end = [block.text for block in pages.blocks([PAGE]) if block.language == "bash"]
    scratch = next(block.text for block in pages.blocks([PAGE]) if block.text.startswith("# scratch.py"))
    start = start.replace("POLICY", f"'{POLICY}' --set env_cfg_type=franka_single")
    scratch = scratch.replace('"ROBOT"', '"franka_single"').replace('"CAMERA"', '"cam_head"')
    (tmp_path / "scratch.py").write_text(scratch)
    # As where the first process of a container collects nobody: what has ended stays in the table of processes.
    processes.adopt_orphans()
    try:
        line = json.loads(_bash(start, tmp_path))
        assert line["event"] == "ready"
        answer = subprocess.run(
            [sys.executable, "scratch.py"], cwd=tmp_path, check=True, capture_output=True, text=True, env=_environment()
        )
        assert "arm_joint_state" in answer.stdout
    finally:
        _bash(end, tmp_path)
    log = (tmp_path / "serve.log").read_text()
    assert "error" not in log
    assert "Traceback" not in log


def test_a_server_that_cannot_start_ends_the_wait(tmp_path: Path) -> None:
    start, _ = [block.text for block in pages.blocks([PAGE]) if block.language == "bash"]
    line = _bash(start.replace("POLICY", str(tmp_path / "Nowhere")), tmp_path)
    assert '"event": "ready"' not in line
    assert "Nowhere" in (tmp_path / "serve.log").read_text()


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def _bash(text: str, folder: Path) -> str:
    """Run a piece of the page in a shell of its own, with `xpl` on its path."""
    tools = folder / "bin"
    tools.mkdir(exist_ok=True)
    (tools / "xpl").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m xpl_cli "$@"\n')
    (tools / "xpl").chmod(0o755)
    path = f"{tools}{os.pathsep}{os.environ['PATH']}"
    completed = subprocess.run(
        [shutil.which("bash") or "bash", "-c", text.replace("sleep 1", "sleep 0.1")],
        cwd=folder,
        env={**_environment(), "PATH": path},
        check=False,
        stdout=subprocess.PIPE,
        text=True,
    )
    return completed.stdout
