"""`xpl demo`: the first thing a newcomer sees."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def test_the_demo_shows_a_green_scaffold_and_a_caught_copy(tmp_path: Path) -> None:
    """It leaves nothing behind in the working directory, and its JSON form lists every step with its exit code."""
    done = subprocess.run(
        [sys.executable, "-m", "xpl_cli", "demo", "--json"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert [step["exit_code"] for step in json.loads(done.stdout)["steps"]] == [0, 0, 0, 1]
    assert list(tmp_path.iterdir()) == []
