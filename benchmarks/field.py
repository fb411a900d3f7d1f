"""Audit public adapters, unmodified, with the libraries and weights that are here.

    python benchmarks/field.py CHECKOUT [ADAPTER...] [--copied] [--defects FILE] [--json FILE]

CHECKOUT is a clone of the ecosystem's repository. Each adapter is audited in the static and in the offline gate, by the
usual commands, and these figures are recorded:

- loaded: `Model(config)` returned; served: it answered a plain observation;
- judged: the offline gate reached a verdict from rules that ran: numbers of passed, failed and warning rules, and of
  rules that could not run; wall and processor seconds of the offline gate. Processor time counts, since other work on
  the machine changes it least;
- findings: of MUST (failures) and of SHOULD (warnings), each gate by itself;
- found: verified defects, from a file, that a finding of either gate is about; `verified.py` defines when.

`--copied` audits a copy of each adapter's folder alone, outside of the checkout.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.verified import is_about

LIMIT_S = 120.0
"""Processor time that the offline gate of one adapter may take, s."""
JUDGED = 10
"""How many rules of the offline gate must have run for a verdict."""
_PATIENCE_S = 600.0  # of wall time, on a machine that others use, too


@dataclass
class Row:
    """What was seen of one adapter."""

    adapter: str
    loaded: bool = False
    served: bool = False
    judged: bool = False
    seconds: float = 0.0
    cpu: float = 0.0
    outcomes: dict[str, int] = field(default_factory=dict)
    verdict: str = ""
    why: str = ""
    must: list[dict[str, Any]] = field(default_factory=list)
    warned: list[dict[str, Any]] = field(default_factory=list)
    static: list[dict[str, Any]] = field(default_factory=list)
    defects: int = 0
    found: list[dict[str, Any]] = field(default_factory=list)
    missed: list[dict[str, Any]] = field(default_factory=list)


def main() -> None:
    """Audit and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("checkout", type=Path)
    parser.add_argument("adapters", nargs="*")
    parser.add_argument("--copied", action="store_true", help="audit a copy of the folder alone")
    parser.add_argument("--no-static", action="store_true", help="the offline gate alone")
    parser.add_argument("--defects", type=Path, help="JSON with verified defects: adapter, file, line, defect_class")
    parser.add_argument("--options", default="", help="options of xpl audit, as --python PATH")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything there")
    arguments = parser.parse_args()
    names = arguments.adapters or sorted(path.parent.name for path in arguments.checkout.glob("policy/*/model.py"))
    defects = json.loads(arguments.defects.read_text())["defects"] if arguments.defects else []
    print(
        f"{'adapter':<20} {'loaded':<6} {'served':<6} {'judged':<6} {'s':>5} {'CPU':>4}  "
        "pass fail warn  n/r  n/a  must  found"
    )
    rows = []
    for name in names:
        row = _audit_adapter(arguments.checkout / "policy" / name, arguments)
        _compare(row, [defect for defect in defects if defect["adapter"] == name])
        rows.append(row)
        _tell(row)
        if arguments.json:
            arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    _sum_up(rows)


def _audit_adapter(folder: Path, arguments: argparse.Namespace) -> Row:
    with tempfile.TemporaryDirectory(prefix="xpl-field-") as name:
        if arguments.copied:
            copy = Path(name) / "policy" / folder.name
            shutil.copytree(folder, copy, symlinks=True)
            folder = copy
        row = Row(folder.name)
        started, before = time.monotonic(), _cpu()
        offline = _gate(folder, "offline", arguments.options.split())
        row.seconds, row.cpu = round(time.monotonic() - started, 1), round(_cpu() - before, 1)
        _read(row, offline)
        if not arguments.no_static:
            row.static = _findings(_gate(folder, "static", []))
    return row


def _cpu() -> float:
    """Return the processor time of all commands so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _gate(folder: Path, gate: str, options: list[str]) -> dict[str, Any]:
    """Return the report of one gate."""
    command = [sys.executable, "-m", "xpl_cli", "audit", str(folder), "--gate", gate, "--format", "json", *options]
    command += ["--time-limit", f"{_PATIENCE_S:g}s"]
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    done = subprocess.run(command, check=False, capture_output=True, stdin=subprocess.DEVNULL, env=environment)
    try:
        target: dict[str, Any] = json.loads(done.stdout)["targets"][0]
    except (ValueError, LookupError):
        return {
            "statement": (done.stderr.decode(errors="replace").strip().splitlines() or ["no output"])[-1],
            "gates": [],
        }
    return target


def _read(row: Row, target: dict[str, Any]) -> None:
    row.verdict = target["statement"]
    for gate in target["gates"]:
        results = {result["slug"]: result for result in gate["results"]}
        row.outcomes = dict(Counter(result["outcome"] for result in gate["results"]))
        serves, structure = results.get("serves", {}), results.get("action-structure", {})
        row.loaded = gate["profile"] is not None
        ran = sum(row.outcomes.get(kind, 0) for kind in ("pass", "fail", "warn"))
        row.served = row.loaded and structure.get("outcome") in {"pass", "fail", "warn"}
        row.judged = row.served and ran >= JUDGED and row.cpu <= LIMIT_S
        row.why = serves.get("reason") or structure.get("reason") or ""
        for finding in _findings({"gates": [gate]}):
            (row.must if finding["outcome"] == "fail" else row.warned).append(finding)


def _findings(target: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {"code": result["code"], "slug": result["slug"], "outcome": result["outcome"], **_place(finding)}
        for gate in target["gates"]
        for result in gate["results"]
        for finding in result["findings"]
    ]


def _place(finding: dict[str, Any]) -> dict[str, Any]:
    return {key: finding.get(key) for key in ("path", "line", "message")}


# -- verified defects --------------------------------------------------------------------------------------------------


def _compare(row: Row, defects: list[dict[str, Any]]) -> None:
    """Note which verified defects a finding is about."""
    row.defects = len(defects)
    for defect in defects:
        hits = (finding for finding in (*row.static, *row.must, *row.warned) if is_about(finding, defect))
        hit = next(hits, None)
        entry = {key: defect.get(key) for key in ("file", "line", "defect_class")}
        if hit is None:
            row.missed.append(entry)
        else:
            row.found.append({**entry, "by": hit["code"]})


def _tell(row: Row) -> None:
    counts = " ".join(
        f"{row.outcomes.get(kind, 0):>4}" for kind in ("pass", "fail", "warn", "not_run", "not_applicable")
    )
    marks = " ".join(f"{'yes' if value else 'no':<6}" for value in (row.loaded, row.served, row.judged))
    matched = f"{len(row.found)}/{row.defects}" if row.defects else ""
    print(
        f"{row.adapter:<20} {marks} {row.seconds:>5.0f} {row.cpu:>4.0f}  {counts}  {len(row.must):>4}  {matched:<5}  "
        f"{row.why[:150]}",
        flush=True,
    )


def _sum_up(rows: list[Row]) -> None:
    total, defects = len(rows), sum(row.defects for row in rows)
    parts = [f"{name} {sum(getattr(row, name) for row in rows)}/{total}" for name in ("loaded", "served", "judged")]
    if defects:
        parts.append(f"verified defects found {sum(len(row.found) for row in rows)}/{defects}")
    print(", ".join(parts))


if __name__ == "__main__":
    main()
