"""`benchmarks/evaluation.py` measures what it says, on this machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.checkout import ROOT

pytest.importorskip("mujoco")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_speed_and_cost_of_recorded_runs_are_measured(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    command = [sys.executable, "benchmarks/evaluation.py", "--episodes", "2", "--rounds", "1", "--json", str(file)]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    assert "speed-up" in done.stdout
    figures = json.loads(file.read_text())
    assert all(rate > 0 for rates in figures["workers"]["episodes_per_hour"].values() for rate in rates)
    assert figures["workers"]["speedup"] > 0.0
    assert figures["recording"]["processor"]["overhead"] > -1.0
