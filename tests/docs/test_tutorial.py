"""The tutorial for PyTorch is followed as it stands: its code is put where it says, and its commands are run."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import pages
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode

PAGE = ROOT / "docs" / "tutorial-torch.md"
BLOCKS = list(pages.blocks([PAGE]))
CODE = [block for block in BLOCKS if block.language == "python"]
TORCH = "XPL_TORCH_PYTHON"
"""Environment variable: a Python that has PyTorch, our own by default; `install` follows that step of the page, too.

It is not done unasked: where the index has no build for CPUs, it is a matter of gigabytes.
"""


def _torch() -> str | None:
    """Return the interpreter that has PyTorch, None if there is none, or `install`."""
    return os.environ.get(TORCH) or (sys.executable if importlib.util.find_spec("torch") else None)


def _write(block: pages.Block, folder: Path) -> None:
    """Put code where the page says: a whole file, or a function in place of the one of its name."""
    path = folder / block.mark
    if not path.exists():
        path.write_text(block.text)
        return
    (function,) = ast.parse(block.text).body
    assert isinstance(function, ast.FunctionDef)
    text = path.read_text()
    (old,) = (node for node in ast.parse(text).body if getattr(node, "name", None) == function.name)
    lines = text.splitlines(keepends=True)
    path.write_text("".join([*lines[: old.lineno - 1], block.text, *lines[old.end_lineno :]]))


def _run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command of the page, with what is at hand in place of an installation."""
    if words[0] == "python":
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, *words[1:]]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env=environment)
    python = _torch()
    if words[1] == "install" and python not in (None, "install"):
        (folder / words[2] / ".venv").symlink_to(Path(str(python)).parent.parent)
        return subprocess.CompletedProcess(words, 0, "", "")
    return xpl(*words[1:], cwd=folder)


def test_the_code_fits_into_what_is_scaffolded(tmp_path: Path) -> None:
    first = next(words for block in BLOCKS if block.language == "console" for words in pages.shell(block.text))
    assert _run(first, tmp_path).returncode == ExitCode.CLEAN
    for block in CODE:
        _write(block, tmp_path)
    done = xpl("audit", "policy/Copycat", "--gate", "static", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stdout
    assert set(re.findall(r"XPL\d{3}", done.stdout)) == {"XPL139"}, done.stdout  # places that are still open


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_tutorial_goes_as_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From an empty folder to a cube that is lifted; without PyTorch for this machine there is nothing to follow."""
    if _torch() is None:
        pytest.skip(f"PyTorch is not here: name a Python that has it by {TORCH}, or install it with {TORCH}=install")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # threads that wait for each other help nobody here
    outputs = []
    for block in BLOCKS:
        if block.language == "python":
            _write(block, tmp_path)
        for words in pages.shell(block.text) if block.language == "console" else ():
            done = _run(words, tmp_path)
            assert done.returncode == ExitCode.CLEAN, f"{block}: {done.stdout}{done.stderr}"
            outputs.append(done.stdout)
    audit, lifted, elsewhere = outputs[-3:]
    assert "verdict  OPEN" in audit
    assert "nothing wrong in what ran" in audit
    assert "profile=shadow" not in audit
    (expected,) = (block.text.strip() for block in BLOCKS if block.language == "text")
    assert expected in lifted
    assert "1 of 1 succeeded" not in elsewhere
