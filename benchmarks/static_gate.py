"""Duration of the static gate, beside `ruff check` on the same files.

Without arguments it audits a fresh scaffold, and a tree of 40 adapters with 4,000 files, most of them vendored, that is
the same in every run. Folders in the arguments, such as those of a checkout of public adapters, are audited one by one
and all at once instead. Commands run in turn (A B C A B C ...) on at most two cores, so that a machine that changes its
speed changes all of them alike. Wall time is what a user waits; CPU time is what other load on the machine changes
least.

`ruff check` gets the same folders; once more the files alone that the audit reads in them (the boundary); and those
with all of its rules, whose number is closer to the audit's.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

from xpl_cli.audit.static.source import Source
from xpl_cli.scaffold import adapter as scaffold
from xpl_cli.scaffold.answers import AdapterAnswers

BIN = Path(sys.executable).parent
CORES, ADAPTERS, FILES = 2, 40, 4000
ONE_MS, ALL_MS = 150.0, 4000.0
"""Targets: one adapter with the cache of the last audit, and the tree with and without."""

XPL, UNCACHED = "xpl audit", "xpl audit --no-cache"
RUFF, RUFF_BOUNDARY, RUFF_ALL = "ruff check", "ruff check, boundary", "ruff --select ALL, b."


@dataclass
class Figures:
    """What one command took, ms."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class _Row:
    """One line of the table."""

    subject: str
    command: str
    median_ms: float
    min_ms: float
    max_ms: float
    cpu_ms: float
    ratio: float

    @classmethod
    def of(cls, subject: str, command: str, taken: Figures, base: float) -> _Row:
        """Summarise the durations of a command, beside the median of another."""
        median = statistics.median(taken.wall)
        low, high = min(taken.wall), max(taken.wall)
        return cls(subject, command, median, low, high, statistics.median(taken.cpu), median / base)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("paths", nargs="*", type=Path, metavar="PATH", help="adapters, in place of generated ones")
    parser.add_argument("--adapters", type=int, default=ADAPTERS, help=f"in the generated tree (default {ADAPTERS})")
    parser.add_argument("--runs", type=int, default=7, help="runs of each command, besides the first (default 7)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    rows: list[_Row] = []
    with tempfile.TemporaryDirectory(prefix="xpl-bench-") as name:
        folder = Path(name)
        surroundings = _surroundings(folder)
        subjects = (
            _load_adapters(arguments.paths) if arguments.paths else _generate_adapters(folder, arguments.adapters)
        )
        print(f"{'subject':<22} {'command':<24} {'median ms':>9} {'min':>7} {'max':>7} {'CPU ms':>7} {'x ruff':>7}")
        for title, adapters in subjects:
            rows += _measure(title, _commands(adapters), arguments.runs, surroundings)
    print(
        f"{arguments.runs} runs each on {CORES} cores; ruff without its cache, and without the folders' configuration"
    )
    targets = []
    if not arguments.paths:
        targets = [
            _target(rows, "1 adapter", {XPL}, ONE_MS),
            _target(rows, _title(arguments.adapters), {XPL, UNCACHED}, ALL_MS),
        ]
    for target in targets:
        row_format = (
            "{met:<8} {subject}, {command}: {median_ms:.0f} ms ({cpu_ms:.0f} of CPU), at most {wanted_ms:.0f} wanted"
        )
        print(row_format.format(**target))
    if arguments.json:
        arguments.json.write_text(json.dumps({"rows": [asdict(row) for row in rows], "targets": targets}, indent=2))


def _measure(title: str, commands: dict[str, list[str]], runs: int, surroundings: dict[str, str]) -> list[_Row]:
    """Measure the commands on one subject and print a line for each."""
    figures = _in_turn(commands, runs, surroundings)
    base = statistics.median(figures[RUFF].wall)
    rows = [_Row.of(title, command, taken, base) for command, taken in figures.items()]
    for row in rows:
        spread = f"{row.median_ms:>9.0f} {row.min_ms:>7.0f} {row.max_ms:>7.0f} {row.cpu_ms:>7.0f}"
        print(f"{title:<22} {row.command:<24} {spread} {row.ratio:>7.1f}", flush=True)
    return rows


def _generate_adapters(folder: Path, count: int) -> list[tuple[str, list[Path]]]:
    """Return a fresh scaffold, and the tree."""
    chance = random.Random(7)  # noqa: S311 - filler, no secret
    policies = folder / "tree" / "policy"
    adapters = [_adapter(policies / f"Policy{number:02}", chance) for number in range(count)]
    return [("1 adapter", adapters[:1]), (_title(count), adapters)]


def _title(count: int) -> str:
    return f"{count} adapters"


def _adapter(path: Path, chance: random.Random) -> Path:
    """Write an adapter with its share of the files: model.py imports one of the vendored ones and a helper."""
    answers = AdapterAnswers(**{**scaffold.defaults(), "name": path.name})
    scaffold.write(scaffold.render(answers), path)
    with (path / "model.py").open("a") as model:
        model.write("\n\nfrom .helper import f0  # noqa: E402\nfrom .vendor.part0.code0 import f1  # noqa: E402\n")
    (path / "helper.py").write_text(_code(chance, 150))
    present = sum(file.is_file() for file in path.rglob("*"))
    for number in range(FILES // ADAPTERS - present):
        folder = path / "vendor" / f"part{number // 10}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"code{number}.py").write_text(_code(chance, 40))
    return path


def _code(chance: random.Random, functions: int) -> str:
    """Return a module of plain functions, six lines each."""
    lines = []
    for number in range(functions):
        value = chance.randrange(1000)
        lines += [f"def f{number}(x, table):", f"    for item in x[:{value}]:", f"        table[item] = item * {value}"]
        lines += [
            f"    if len(x) > {value}:",
            f"        return f{max(number - 1, 0)}(x[1:], table)",
            "    return table",
            "",
        ]
    return "\n".join(lines)


def _load_adapters(paths: list[Path]) -> list[tuple[str, list[Path]]]:
    """Return the folders one by one, and all of them."""
    adapters = [path.resolve() for path in paths]
    together = [(_title(len(adapters)), adapters)] if len(adapters) > 1 else []
    return [*((adapter.name[:22], [adapter]) for adapter in adapters), *together]


def _commands(adapters: list[Path]) -> dict[str, list[str]]:
    names = [str(adapter) for adapter in adapters]
    read = [str(adapter / name) for adapter in adapters for name in Source(adapter).python_files]
    audit = [str(BIN / "xpl"), "audit", "--gate", "static"]
    ruff = [str(BIN / "ruff"), "check", "--quiet", "--no-cache", "--isolated"]
    return {
        XPL: [*audit, *names],
        UNCACHED: [*audit, "--no-cache", *names],
        RUFF: [*ruff, *names],
        RUFF_BOUNDARY: [*ruff, *read],
        RUFF_ALL: [*ruff, "--select", "ALL", *read],
    }


def _surroundings(folder: Path) -> dict[str, str]:
    """Return an environment with a cache of its own, and with bytecode, which an installed tool has."""
    own = {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | own


def _in_turn(commands: dict[str, list[str]], runs: int, surroundings: dict[str, str]) -> dict[str, Figures]:
    """Return what each command took."""
    figures = {name: Figures() for name in commands}
    for turn in range(runs + 1):
        for name, command in commands.items():
            before, started = _cpu(), time.perf_counter()
            done = subprocess.run(command, check=False, stdin=subprocess.DEVNULL, capture_output=True, env=surroundings)
            wall = time.perf_counter() - started
            assert done.returncode in {0, 1, 4}, done.stderr.decode()
            if turn:  # the first turn fills caches
                figures[name].wall.append(wall * 1000)
                figures[name].cpu.append((_cpu() - before) * 1000)
    return figures


def _cpu() -> float:
    """Return the CPU time of all commands so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _target(rows: list[_Row], title: str, commands: set[str], limit_ms: float) -> dict[str, object]:
    """Judge one promise, by the slowest of the ways to audit."""
    row = max((row for row in rows if row.subject == title and row.command in commands), key=lambda row: row.median_ms)
    met = "met" if row.median_ms <= limit_ms else "missed"
    return {"subject": title, "command": row.command, "median_ms": row.median_ms, "cpu_ms": row.cpu_ms} | {
        "wanted_ms": limit_ms,
        "met": met,
    }


if __name__ == "__main__":
    main()
