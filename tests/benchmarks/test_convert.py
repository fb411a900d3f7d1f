"""The benchmark of conversions measures what it says; how good the figures are is not judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from tests.support.checkout import ROOT

if TYPE_CHECKING:
    from pathlib import Path

pytest.importorskip("cv2")

ROWS = [
    ("bilinear", "xpl.convert"),
    ("bilinear", "OpenCV"),
    ("bilinear antialias", "xpl.convert"),
    ("bilinear antialias", "Pillow"),
    ("area", "xpl.convert"),
    ("area", "OpenCV"),
    ("bicubic antialias", "xpl.convert"),
    ("bicubic antialias", "Pillow"),
    ("lanczos antialias", "xpl.convert"),
    ("lanczos antialias", "Pillow"),
]


@pytest.mark.slow
def test_the_benchmark_of_conversions_compares_equal_filters(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    command = [sys.executable, "benchmarks/convert.py", "--runs", "1", "--json", str(file)]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = json.loads(file.read_text())["rows"]
    assert [(row["filter"], row["way"]) for row in rows] == ROWS
    assert all(0 < row["min_ms"] <= row["median_ms"] <= row["max_ms"] for row in rows)
    assert all(row["apart"] <= 1 for row in rows)
