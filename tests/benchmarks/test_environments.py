"""`benchmarks/environments.py` measures what it says, on this machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.places import ROOT

pytest.importorskip("mujoco")


@pytest.mark.slow
def test_our_own_figures_are_measured(tmp_path: Path) -> None:
    """Every task's physics, every camera size by ray casting, episodes per hour; what cannot be measured says why."""
    file = tmp_path / "figures.json"
    done = subprocess.run(
        [sys.executable, "benchmarks/environments.py", "--no-peers", "--json", str(file)],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    assert "episodes/h" in done.stdout
    figures = json.loads(file.read_text())
    ratios = [row["raw_ms"] / row["act_ms"] for row in figures["physics"] if "not_run" not in row]
    assert len(ratios) >= 10
    assert all(0.3 < ratio < 1.05 for ratio in ratios)
    cast = {tuple(row["size"]): row["ms"] for row in figures["cameras"] if row["renderer"] == "raycast"}
    assert 0 < cast[224, 224] < cast[480, 640]
    for row in figures["physics"] + figures["cameras"]:
        assert row.get("not_run", "why") != ""
