"""The benchmark of the static gate measures what it says; how good the figures are is not judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.checkout import ROOT

COMMANDS = ["xpl audit", "xpl audit --no-cache", "ruff check", "ruff check, boundary", "ruff --select ALL, b."]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("chosen", "subjects"),
    [(["--adapters", "2"], ["1 adapter", "2 adapters"]), (["policy/demo_policy"], ["demo_policy"])],
)
def test_the_static_benchmark_measures_every_command(tmp_path: Path, chosen: list[str], subjects: list[str]) -> None:
    file = tmp_path / "figures.json"
    done = subprocess.run(
        [sys.executable, "benchmarks/static_gate.py", "--runs", "1", "--json", str(file), *chosen],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    figures = json.loads(file.read_text())
    assert [(row["subject"], row["command"]) for row in figures["rows"]] == [
        (subject, command) for subject in subjects for command in COMMANDS
    ]
    assert all(0 < row["min_ms"] <= row["median_ms"] <= row["max_ms"] for row in figures["rows"])
    assert all(row["cpu_ms"] > 0 and row["ratio"] > 0 for row in figures["rows"])
    assert [target["subject"] for target in figures["targets"]] == (subjects if "--adapters" in chosen else [])
    assert all(target["met"] in {"met", "missed"} and target["median_ms"] > 0 for target in figures["targets"])
