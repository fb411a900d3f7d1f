"""`xpl demo`: the first thing a newcomer sees."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from tests.support.peer import xpl
from xpl_cli.demo import Demo, DemoStep
from xpl_cli.standard import answers

if TYPE_CHECKING:
    from pathlib import Path


class Brief(Demo):
    """The route with audits by one rule, in processes that start at once."""

    def _run(self, step: DemoStep) -> None:
        rule = ["--select", "batch-order"] if step.command[0] == "audit" else []
        step.code = xpl(*step.command, *rule, cwd=self.folder).returncode
        self.steps.append(step)


def test_the_route_leads_from_a_green_scaffold_to_a_caught_copy(tmp_path: Path) -> None:
    said: list[str] = []
    demo = Brief(tmp_path, said.append, quiet=True)
    assert demo.run()
    assert [step.code for step in demo.steps] == [0, 0, 0, 1]
    assert any("returned" in line for line in said)


@pytest.mark.slow
def test_the_demo_shows_a_green_scaffold_and_a_caught_copy(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "xpl_cli", "demo", "--json"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answers.problems(answer) == []
    assert [step["exit_code"] for step in answer["steps"]] == [0, 0, 0, 1]
    assert list(tmp_path.iterdir()) == []
