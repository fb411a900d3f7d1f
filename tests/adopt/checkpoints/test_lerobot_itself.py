"""A checkpoint that LeRobot wrote becomes an adapter that says what LeRobot's own pipeline says; no line is written.

`XPL_LEROBOT_PYTHON` names a Python that has LeRobot; CONTRIBUTING.md says how to make one. Without it this is not run.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode

PYTHON = os.environ.get("XPL_LEROBOT_PYTHON", "")
MAKER = Path(__file__).with_name("lerobot_maker.py")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(not PYTHON, reason="not run: XPL_LEROBOT_PYTHON names no Python that has LeRobot"),
]


@pytest.mark.parametrize("kind", ["act", "diffusion"])
def test_a_checkpoint_of_lerobot_is_served_and_equals_lerobot(tmp_path: Path, kind: str) -> None:
    """new-policy, model_io record, audit: parity over histories, resets and several environments."""
    checkpoint = tmp_path / "shirts"
    subprocess.run([PYTHON, str(MAKER), kind, str(checkpoint)], check=True, capture_output=True)
    package = xpl(
        *("new-policy", "Shirts", "--from", str(checkpoint), "--embodiment", "aloha_agilex", "--gripper", "0,1"),
        cwd=tmp_path,
    )
    assert package.returncode == ExitCode.CLEAN, package.stderr
    recorded = xpl("model-io", "record", "policy/Shirts", "--python", PYTHON, "--json", cwd=tmp_path)
    assert recorded.returncode == ExitCode.CLEAN, recorded.stderr
    rules = ("--select", "XPL260", "--select", "XPL261")
    audited = xpl(
        *("audit", "policy/Shirts", "--gate", "offline", *rules, "--python", PYTHON, "--format", "json"),
        cwd=tmp_path,
    )
    assert audited.returncode == ExitCode.CLEAN, audited.stdout + audited.stderr
    (target,) = json.loads(audited.stdout)["targets"]
    outcomes = {result["code"]: result["outcome"] for gate in target["gates"] for result in gate["results"]}
    assert outcomes["XPL260"] == outcomes["XPL261"] == "pass"
