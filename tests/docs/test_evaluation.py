"""docs/evaluation.md: the command that reproduces a policy, and what it promises."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from tests.support.checkout import ROOT
from xpl_cli.evaluation.runs import plan
from xpl_cli.main import app
from xpl_cli.packages import package
from xpl_cli.packages.environments import find

TEXT = (ROOT / "docs" / "evaluation.md").read_text(encoding="utf-8")


def _block(mark: str) -> str:
    """Return the code block behind a mark in the page."""
    match = re.search(rf"<!-- {mark}[^>]*-->\n+```\w*\n(.*?)```", TEXT, re.DOTALL)
    assert match, mark
    return match[1]


def _arguments() -> list[str]:
    """Return what the documented command gives to `xpl`."""
    script, tool, *arguments = shlex.split(_block("reproduce"))
    assert (script, tool) == ("./dev", "xpl")
    return arguments


def test_the_command_plays_what_the_table_shows() -> None:
    name, *arguments = _arguments()
    command = typer.main.get_command(app).get_command(None, name)  # type: ignore[attr-defined]
    params = command.make_context(name, arguments).params
    adapter = package.load(ROOT / params["policy"])
    request = plan.PlanRequest(params["task"], params["setting"], params["episodes"], horizon=params["horizon"])
    planned = plan.make_plan(adapter, find(params["env"]), adapter.config(), request).plan
    rows = [line.split()[:3] for line in _block("table").splitlines()]
    expected = [[*cell.cell_key, f"{params['episodes']}/{params['episodes']}"] for cell in planned.cells]
    assert [row for row in rows if row in expected] == expected
    assert all(cell.frozen for cell in planned.cells)
    assert f"{len(planned.slots())} episodes" in TEXT


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_command_reproduces_the_table(tmp_path: Path) -> None:
    arguments = _arguments()
    arguments[arguments.index("--out") + 1] = str(tmp_path / "run")
    done = subprocess.run(
        [sys.executable, "-m", "xpl_cli", *arguments], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert _block("table").strip() in done.stdout
