"""What the tool makes of adapters of the field, unmodified and without their weights and libraries.

    python benchmarks/field.py CHECKOUT [ADAPTER...] [--copied] [--defects FILE] [--json FILE]

CHECKOUT is a clone of the ecosystem's repository. Each adapter is audited in the static and in the offline gate, by the
commands that anybody would run, and this is written down of it:

- loaded: `Model(config)` returned; served: it answered a plain observation with something;
- judged: the offline gate came to a verdict from rules that ran, which are told as passed, failed and warned, and how
  many could not be run; wall and processor seconds of the offline gate. What counts is the processor time, which
  other work on the machine changes least;
- findings: of MUST (failures) and of SHOULD (warnings), each gate by itself;
- found: verified defects, given in a file, that a finding of either gate is about: by a rule about this class of defect
  (`PROVES`), and in the static gate not farther than 30 lines from it in the same file.

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

LIMIT_S = 120.0
"""Processor time that the offline gate of one adapter may take, s."""
JUDGED = 10
"""How many rules of the offline gate must have run for a verdict."""
_PATIENCE_S = 600.0  # of wall time, on a machine that others use, too
_NEAR = 30  # lines between a finding and the defect that it is about


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
    stubbed: list[str] = field(default_factory=list)
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
    parser.add_argument("--options", default="--shadow", help="options of xpl audit (default: --shadow)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything there")
    asked = parser.parse_args()
    names = asked.adapters or sorted(path.parent.name for path in asked.checkout.glob("policy/*/model.py"))
    known = json.loads(asked.defects.read_text())["defects"] if asked.defects else []
    print(
        f"{'adapter':<20} {'loaded':<6} {'served':<6} {'judged':<6} {'s':>5} {'CPU':>4}  "
        "pass fail warn  n/r  n/a  must  found"
    )
    rows = []
    for name in names:
        row = _audited(asked.checkout / "policy" / name, asked)
        _compare(row, [defect for defect in known if defect["adapter"] == name])
        rows.append(row)
        _tell(row)
        if asked.json:
            asked.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    _sum_up(rows)


def _audited(folder: Path, asked: argparse.Namespace) -> Row:
    with tempfile.TemporaryDirectory(prefix="xpl-field-") as name:
        if asked.copied:
            copy = Path(name) / "policy" / folder.name
            shutil.copytree(folder, copy, symlinks=True)
            folder = copy
        row = Row(folder.name)
        started, before = time.monotonic(), _cpu()
        offline = _gate(folder, "offline", asked.options.split())
        row.seconds, row.cpu = round(time.monotonic() - started, 1), round(_cpu() - before, 1)
        _read(row, offline)
        if not asked.no_static:
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
        row.stubbed = gate["stubbed"]
        serves, structure = results.get("serves", {}), results.get("action-structure", {})
        row.loaded = gate["profile"] is not None
        ran = sum(row.outcomes.get(kind, 0) for kind in ("pass", "fail", "warn"))
        row.served = row.loaded and structure.get("outcome") in {"pass", "fail", "warn"}
        row.judged = row.served and ran >= JUDGED and row.cpu <= LIMIT_S
        row.why = serves.get("reason") or structure.get("reason") or ""
        for found in _findings({"gates": [gate]}):
            (row.must if found["outcome"] == "fail" else row.warned).append(found)


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

_TABLE = """
batch misalignment: 109 111 113 203 204 205 207 218 219 220
batch: per-env loop: 113 203 207 218 219
env_idx: 112 206
empty env_idx_list: 110 204
wrong RPC: 106 135
missing contract method: 105 203
hard-coded env count: 172 205
reset does not clear: 115 144 208 209
reset is a no-op: 115 144 208 209
model-side cache: 115 144 208
counter survives: 115 144 208
reset failure: 116 224
unbounded history: 142 223
inference mutates: 140 141 211 226
defaults set only in reset: 145 254
channel swap: 121 225
channel-order default: 121 166 191
train/eval channel: 122
checkpoint step: 126 251
normalisation stats: 126 148
mutates checkpoint: 127 252
hard-coded dims: 125 147
hard-coded action: 125 202
hard-coded robot: 125 147 166
hard-coded internal: 130
normalisation silently: 148
constant dims: 148
un-normalised: 147 148
unsupported action_type: 149 202
action_type ignored: 149 202
language silently: 146 147 196
print on every: 132
missing camera: 123 213
missing action key: 124
partial weight: 128
instruction ignored: 196 212 215 220
state truncated: 125
rotation singularity: 151 240
single-arm key: 152
config value never: 120
dead config: 120
comment contradicts: 120 166
device hard-coded: 153
seed 0: 118 214 248
run seed: 118 214 248
bool(): 117 249
null in deploy: 119 250
wrong config key: 120 167
internal: 130
mirror: 130
credential: 130
wrong sys.path: 161 189
wrong env_cfg: 161 201
relative path: 129
shared CWD: 129
merge-conflict: 102
no episode-end: 134
custom RPC: 135
possible infinite: 133 134 136
exact-zero: 173
bare except: 131
required file: 101
undeclared runtime: 162
"""
PROVES = {
    start: {f"XPL{code}" for code in codes.split()}
    for start, _, codes in (line.rpartition(": ") for line in _TABLE.strip().splitlines())
}
"""Beginnings of a defect's class, and the rules that are about it. Findings of the static gate must be near its line,
too; those of the offline gate are about behaviour, and have none."""


def _compare(row: Row, known: list[dict[str, Any]]) -> None:
    """Note which verified defects a finding is about."""
    row.defects = len(known)
    for defect in known:
        rules = {code for start, codes in PROVES.items() if defect["defect_class"].startswith(start) for code in codes}
        near = (found for found in row.static if found["code"] in rules and _is_near(found, defect))
        hit = next(near, None) or next((found for found in (*row.must, *row.warned) if found["code"] in rules), None)
        entry = {key: defect.get(key) for key in ("file", "line", "defect_class")}
        if hit is None:
            row.missed.append(entry)
        else:
            row.found.append({**entry, "by": hit["code"]})


def _is_near(found: dict[str, Any], defect: dict[str, Any]) -> bool:
    path, line = str(found["path"] or ""), defect.get("line")
    if not path:
        return Path(defect["file"]).name in found["message"]
    if not f"/{defect['file']}".endswith("/" + path.removeprefix("./")):
        return False
    return line is None or found["line"] is None or abs(found["line"] - line) <= _NEAR


def _tell(row: Row) -> None:
    counts = " ".join(
        f"{row.outcomes.get(kind, 0):>4}" for kind in ("pass", "fail", "warn", "not_run", "not_applicable")
    )
    marks = " ".join(f"{'yes' if value else 'no':<6}" for value in (row.loaded, row.served, row.judged))
    found = f"{len(row.found)}/{row.defects}" if row.defects else ""
    print(
        f"{row.adapter:<20} {marks} {row.seconds:>5.0f} {row.cpu:>4.0f}  {counts}  {len(row.must):>4}  {found:<5}  "
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
