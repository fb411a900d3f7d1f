"""`xpl demo`: the first thing a newcomer sees."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from xpl_cli.demo import Demo, Step
from xpl_cli.standard import answers

if TYPE_CHECKING:
    from pathlib import Path


class Brief(Demo):
    """The route with audits of a few rules."""

    def _run(self, step: Step) -> None:
        if step.command[0] == "audit":
            step = replace(step, command=[*step.command, "--select", "XPL1", "--select", "XPL203"])
        super()._run(step)


def test_the_route_leads_from_a_green_scaffold_to_a_caught_copy(tmp_path: Path) -> None:
    said: list[str] = []
    demo = Brief(tmp_path, said.append, quiet=True)
    assert demo.play()
    assert [step.code for step in demo.steps] == [0, 0, 0, 1]
    assert any("answered" in line for line in said)


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


@pytest.mark.slow
def test_on_a_terminal_the_demo_asks_nothing_and_ends_with_the_next_commands(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "xpl_cli", "demo"], cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # Linux reports the end of a terminal as an error
        while chunk := os.read(ours, 65536):
            shown += chunk
    os.close(ours)
    assert process.wait() == 0, shown.decode()
    landmarks = [b"new-policy", b"answered", b"OPEN", b"batch-by-position", b"RED", b"xpl new-policy Foo"]
    place = 0
    for landmark in landmarks:  # each after the one before: a slow machine's progress line names rules early, too
        place = shown.find(landmark, place)
        assert place != -1, (landmark, shown.decode())
