"""`benchmarks/environments.py` measures what it says, on this machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.checkout import ROOT

pytest.importorskip("mujoco")


@pytest.mark.slow
def test_our_own_figures_are_measured(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    done = subprocess.run(
        [sys.executable, "benchmarks/environments.py", "--no-peers", "--rounds", "2", "--json", str(file)],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    assert "episodes/h" in done.stdout
    figures = json.loads(file.read_text())
    played = [row for row in figures["physics"] if "not_run" not in row]
    assert len(played) >= 10
    assert all(row["raw_ms"] > 0 and row["act_ms"] > 0 for row in played)
    cast = {tuple(row["size"]): row["ms"] for row in figures["cameras"] if row["renderer"] == "raycast"}
    assert cast.keys() == {(224, 224), (480, 640)}
    assert all(taken > 0 for taken in cast.values())
    for row in figures["physics"] + figures["cameras"]:
        assert row.get("not_run", "why") != ""
