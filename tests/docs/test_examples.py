"""Examples of the pages that are run whole: the first steps, and clients that ask a real server."""

from __future__ import annotations

import ast
import asyncio
import inspect
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support import pages
from tests.support.checkout import ROOT
from tests.support.peer import DEADLINE_S, xpl
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.basics.errors import ExitCode
from xpl_cli.serving.launch import running_server

TUTORIAL = list(pages.blocks([ROOT / "docs" / "tutorial.md"]))
SERVED = [block for block in pages.blocks() if block.mark == "runs with a server"]


def _follow(folder: Path, blocks: list[pages.Block], *, gates: set[str]) -> list[tuple[list[str], int]]:
    """Do what blocks of the tutorial say in a folder; return the commands with their exit codes.

    Args:
        folder: an empty folder.
        blocks: code becomes the model, a difference is applied to it, commands are run.
        gates: audits of other gates, or of all, are left out.
    """
    model = folder / "policy" / "First" / "model.py"
    done = []
    for block in blocks:
        if block.language == "python":
            model.write_text(block.text)
        elif block.language == "diff":
            old, new = (line[1:] for line in block.text.splitlines())
            assert model.read_text().count(old) == 1
            model.write_text(model.read_text().replace(old, new))
        elif block.language == "console":
            for _, *words in pages.shell(block.text):
                gate = words[words.index("--gate") + 1] if "--gate" in words else "all"
                if words[0] == "new-policy" or gate in gates:
                    run = xpl(*words, cwd=folder)
                    assert run.returncode in {ExitCode.CLEAN, ExitCode.FINDINGS}, run.stderr
                    done.append((words, run.returncode))
    return done


def test_the_first_steps_go_as_they_say(tmp_path: Path) -> None:
    done = _follow(tmp_path, TUTORIAL, gates={Gate.STATIC, Gate.OFFLINE})
    assert [code for _, code in done] == [ExitCode.CLEAN, ExitCode.CLEAN, ExitCode.FINDINGS]
    assert done[-1][0][-1] == "batch-order"


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_model_of_the_first_steps_passes_all_gates_and_plays(tmp_path: Path) -> None:
    mistake = next(index for index, block in enumerate(TUTORIAL) if block.language == "diff")
    done = _follow(tmp_path, [*TUTORIAL[:mistake], TUTORIAL[-1]], gates={Gate.STATIC, "all"})
    assert [(words[0], code) for words, code in done] == [("new-policy", 0), ("audit", 0), ("audit", 0), ("eval", 0)]


def _tour() -> list[list[str]]:
    """Return the commands of the README's tour, as words behind `xpl`."""
    tour = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Sixty seconds\n")[2].partition("\n```\n")[0]
    commands = pages.shell(tour.partition("```bash\n")[2])
    assert [words[:2] for words in commands] == [["xpl", name] for name in ("new-policy", "audit", "eval", "serve")]
    return [words[1:] for words in commands]


def _served(words: list[str], folder: Path) -> None:
    """Serve as the tour does, but on a port that is free, until the server is ready; then end it."""
    index = words.index("--port") + 1
    command = [sys.executable, "-m", "xpl_cli", *words[:index], "0", *words[index + 1 :]]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True) as server:
        try:
            assert server.stdout is not None
            assert json.loads(server.stdout.readline())["url"].startswith("ws://")
            server.terminate()
            assert server.wait(DEADLINE_S) in {ExitCode.CLEAN, ExitCode.INTERRUPTED}
        finally:
            server.kill()


def test_the_tour_of_the_readme_begins_and_ends_as_written(tmp_path: Path) -> None:
    """The package is made, its files are clean, and it is served; test_packaging.py runs the rest from a wheel."""
    made, audited, _, served = _tour()
    assert xpl(*made, cwd=tmp_path).returncode == ExitCode.CLEAN
    done = xpl(*audited, "--gate", "static", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stdout
    _served(served, tmp_path)


@pytest.fixture(scope="module")
def url() -> Any:
    """Return the address of a server that answers for two arms."""
    with running_server(ROOT / "policy" / "demo_policy", {"env_cfg_type": "arx_x5"}) as server:
        yield server.url


@pytest.mark.parametrize("block", SERVED, ids=str)
def test_a_client_of_the_pages_gets_its_answer(block: pages.Block, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    arms = {f"{side}_arm_joint_state": [0.0] * 6 for side in ("left", "right")}
    grippers = {f"{side}_ee_joint_state": [1.0] for side in ("left", "right")}
    names: dict[str, Any] = {"observation": {"state": {**arms, **grippers}}}
    monkeypatch.setattr(sys, "argv", ["client", url])
    text = block.text.replace("ws://localhost:8000", url)
    code = compile(text, str(block), "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    running = eval(code, names)  # noqa: S307 - our own pages
    if inspect.iscoroutine(running):
        asyncio.run(running)
    assert names.get("chunk") or "ask" in names
