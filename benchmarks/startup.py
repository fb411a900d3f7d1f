"""Start-up time of the command line, beside other commands of the same environment.

Commands run in turn (A B C A B C ...), so that a machine that changes its speed changes all of them alike. Prints
median, spread and the ratio to a bare interpreter.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RUNS = 15
BIN = Path(sys.executable).parent
BASE = "python -c pass"


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory(prefix="xpl-bench-") as folder:
        xpl = str(BIN / "xpl")
        scaffold = [xpl, "new-policy", "Foo"]
        subprocess.run(scaffold, cwd=folder, check=True, stdin=subprocess.DEVNULL, capture_output=True)
        commands = {
            BASE: [sys.executable, "-c", "pass"],
            "xpl --help": [xpl, "--help"],
            "copier --help": [str(BIN / "copier"), "--help"],
            "mypy --help": [str(BIN / "mypy"), "--help"],
            "xpl audit Foo --gate static": [xpl, "audit", "policy/Foo", "--gate", "static"],
        }
        times: dict[str, list[float]] = {name: [] for name in commands}
        for turn in range(RUNS + 1):
            for name, command in commands.items():
                started = time.perf_counter()
                subprocess.run(command, cwd=folder, check=False, stdin=subprocess.DEVNULL, capture_output=True)
                if turn:  # the first turn warms the file cache
                    times[name].append(time.perf_counter() - started)
    base = statistics.median(times[BASE])
    print(f"{'command':<30} {'median ms':>10} {'min':>7} {'max':>7} {'x bare':>7}   ({RUNS} runs each)")
    for name, values in times.items():
        middle = statistics.median(values)
        low, high = min(values) * 1000, max(values) * 1000
        print(f"{name:<30} {middle * 1000:>10.0f} {low:>7.0f} {high:>7.0f} {middle / base:>7.1f}")


if __name__ == "__main__":
    main()
