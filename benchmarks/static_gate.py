"""How long the static gate takes, beside `ruff check` on the same files.

Without arguments it audits a fresh scaffold and the adapters in `policy/`; otherwise the folders that are given, for
example those of a checkout of public adapters. Commands run in turn, so that a machine that changes its speed changes
all of them alike. Whole processes are measured, and the gate alone inside one process, where every import is done.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from xpl_cli import scaffold
from xpl_cli.audit import engine
from xpl_cli.audit.model import Gate
from xpl_cli.audit.options import Options
from xpl_cli.audit.source import Source

RUNS = 9
BIN = Path(sys.executable).parent
POLICIES = Path(__file__).resolve().parent.parent / "policy"


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory(prefix="xpl-bench-") as folder:
        adapters = [Path(name).resolve() for name in sys.argv[1:]]
        if not adapters:
            fresh = Path(folder) / "Foo"
            scaffold.write(scaffold.render(scaffold.Answers(**{**scaffold.defaults(), "name": "Foo"})), fresh)
            adapters = [fresh, *sorted(path.parent for path in POLICIES.glob("*/model.py"))]
        print(f"{'adapter':<20} {'files':>5} {'lines':>6} {'xpl audit':>10} {'ruff check':>11} {'gate alone':>11}   ms")
        for adapter in adapters:
            source = Source(adapter)
            files = [str(adapter / name) for name in source.python_files]
            lines = sum(source.text(name).count("\n") for name in source.files if name in source.text_files)
            audit = [str(BIN / "xpl"), "audit", str(adapter), "--gate", "static"]
            ruff = [str(BIN / "ruff"), "check", "--no-cache", "--select", "ALL", "--isolated", *files]
            whole, beside = _in_turn(audit, ruff)
            alone = _alone(adapter)
            counts = f"{adapter.name:<20} {len(source.files):>5} {lines:>6}"
            print(f"{counts} {whole:>10.0f} {beside:>11.0f} {alone:>11.0f}")
        print(f"medians of {RUNS} runs; ruff with all its rules and no cache")


def _in_turn(*commands: list[str]) -> list[float]:
    """Return the median time of each command, ms."""
    times: list[list[float]] = [[] for _ in commands]
    for turn in range(RUNS + 1):
        for place, command in enumerate(commands):
            started = time.perf_counter()
            done = subprocess.run(command, check=False, stdin=subprocess.DEVNULL, capture_output=True)
            assert done.returncode in {0, 1}, done.stderr.decode()
            if turn:  # the first turn warms the file cache
                times[place].append((time.perf_counter() - started) * 1000)
    return [statistics.median(values) for values in times]


def _alone(adapter: Path) -> float:
    """Return the median time of the gate in a process that has done its imports, ms."""
    times = []
    for turn in range(RUNS + 1):
        started = time.perf_counter()
        report = engine.audit(adapter, "policy", Options(gates=(Gate.STATIC,)))
        assert report.gates[0].results
        if turn:
            times.append((time.perf_counter() - started) * 1000)
    return statistics.median(times)


if __name__ == "__main__":
    main()
