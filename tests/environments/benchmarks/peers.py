"""Environment packages over a benchmark's own code: their Pythons, and programs that run there."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent
LIMIT_S = 1700.0
patient = pytest.mark.timeout(LIMIT_S + 60)
"""The mark of modules whose first test looks at everything: a minute of an idle core, half an hour of a busy one."""


def needed(name: str, python: Path | None) -> pytest.MarkDecorator:
    """Return the mark of tests that play a benchmark: not run where it is not installed."""
    reason = f"not run: {name} is not installed from envs/{name}/{name}.lock.txt; `./dev peers` does so"
    return pytest.mark.skipif(python is None, reason=reason)


def folder(python: Path | None) -> Path:
    """Return the environment of an interpreter."""
    assert python is not None
    return python.parents[1]


def look(name: str, python: Path | None, *arguments: str) -> dict[str, Any]:
    """Return what `look_at_NAME.py` prints, a JSON object, run in a benchmark's own Python."""
    assert python is not None
    command = [str(python), str(FOLDER / f"look_at_{name}.py"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found
