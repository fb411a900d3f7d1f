from __future__ import annotations

import json
import os
import subprocess
import sys
import uuid
from pathlib import Path

import pytest

from tests.support.checkout import ROOT
from tests.support.peer import MARK, processes, wait_until

QUICK = ["benchmarks/serving.py", "--quick", "--only", "tcp,websockets,xpl"]
NAMES = {"tcp", "websockets", "websockets/async", "xpl", "xpl/same", "xpl/websocket"}


@pytest.mark.slow
def test_the_serving_benchmark_measures_every_phase_and_leaves_no_process(tmp_path: Path) -> None:
    """Runs it against what needs no environment of its own, and reads the figures, not how good they are."""
    mark = uuid.uuid4().hex
    file = tmp_path / "figures.json"
    done = subprocess.run(
        [sys.executable, *QUICK, "--json", str(file)],
        cwd=ROOT,
        env={**os.environ, MARK: mark},
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stderr
    wait_until(lambda: not processes(mark), "all processes of the benchmark are gone")
    figures = json.loads(file.read_text())

    assert {row["contender"]: row["status"] for row in figures["contenders"]} == dict.fromkeys(NAMES, "ran")
    payloads = {"state", "1x224x224", "3x480x640", "batch16"}
    assert {(row["payload"], row["contender"]) for row in figures["latency"]} == {
        (payload, name) for payload in payloads for name in NAMES
    }
    for row in figures["latency"]:
        low, high = row["rounds_p50_ms"]
        assert 0 < low <= high
        assert 0 < row["p50_ms"] <= row["p99_ms"]
        assert row["cpu_ms"] > 0
        assert row["ratio"] > 0
        assert row["shared_memory"] == (row["contender"] in {"xpl", "xpl/same"})
    assert all(row["ratio"] == 1 for row in figures["latency"] if row["contender"] == "tcp")

    assert {(row["contender"], row["clients"]) for row in figures["throughput"]} == {("xpl", 1), ("xpl/same", 1)}
    assert all(row["per_s"] > 0 for row in figures["throughput"])
    assert {row["contender"] for row in figures["responsiveness"]} == {"websockets", "xpl"}
    assert all(row[what]["count"] > 0 for row in figures["responsiveness"] for what in ("handshake", "heartbeat"))

    judged = [row for row in figures["targets"] if row["met"] is not None]
    assert len(judged) == 5  # of 7: no peer and not so many clients took part
    assert all(row["wanted"] > 0 and row["got"] > 0 for row in judged)
    assert "3x480x640" in done.stdout
