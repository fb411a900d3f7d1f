"""Which verified defects of the field's adapters the static gate finds, by the rules that are about their class.

    python benchmarks/static_recall.py CHECKOUT DEFECTS [ADAPTER...] [--json FILE]

CHECKOUT is a clone of the ecosystem's repository. DEFECTS is a JSON file with `defects`: adapter, file, line and
defect_class of each. A defect counts as found where a finding of a rule that is about its class lies in the same file,
at most 40 lines away, or anywhere in it where the rule is about what is missing. `benchmarks/field.py` asks for
nearness only, and for both gates. Nothing of the adapters is run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

NEAR = 40
"""Lines between a finding and the defect that it is about."""

ANYWHERE = frozenset(("XPL101", "XPL196"))
"""Rules about what is not there, which has no line."""

ABOUT: dict[str, tuple[int, ...]] = {
    "action_type": (149,),
    "bare except": (131,),
    "batch misalignment: unknown": (111,),
    "batch misalignment": (109,),
    "batch: per-env": (113,),
    "bool()": (117,),
    "channel": (121, 191),
    "checkpoint step": (126,),
    "config value": (120,),
    "counter survives": (115,),
    "credential": (130,),
    "custom RPC": (135,),
    "dead config": (120,),
    "defaults set only in reset": (145,),
    "device": (153,),
    "empty env_idx_list": (110,),
    "env_idx": (112,),
    "exact-zero": (173,),
    "hard-coded env count": (172,),
    "hard-coded internal proxy": (130,),
    "hard-coded robot default": (125, 154),
    "hard-coded": (125,),
    "inference mutates": (140, 141),
    "instruction ignored": (196,),
    "internal": (130,),
    "language silently": (147,),
    "merge-conflict": (102,),
    "mirror": (130,),
    "missing action key": (124,),
    "missing camera": (123,),
    "missing contract": (105,),
    "mutates checkpoint": (127,),
    "no episode-end": (134,),
    "normalisation silently": (148,),
    "normalisation stats": (126, 148),
    "null in deploy.yml": (119,),
    "partial weight": (128,),
    "possible infinite loop": (169,),
    "print on": (132,),
    "relative path": (129,),
    "required file": (101,),
    "reset failure": (116,),
    "reset": (115,),
    "rotation singularity": (151,),
    "run seed": (118,),
    "seed 0": (118,),
    "shared CWD": (129,),
    "single-arm": (152,),
    "state truncated": (125,),
    "task-specific default": (154, 196),
    "train/eval channel": (122,),
    "un-normalised": (148,),
    "unbounded": (142,),
    "unsupported action_type": (149,),
    "wrong RPC": (135,),
    "wrong config key": (120,),
    "wrong sys.path": (161,),
}
"""Beginnings of a defect's class, the longest that fits counts, and the rules that are about it."""


def main() -> int:
    """Audit, and print a line for each adapter and each defect that was not found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("checkout", type=Path)
    parser.add_argument("defects", type=Path)
    parser.add_argument("adapters", nargs="*", help="names; all that have verified defects if none is given")
    parser.add_argument("--json", type=Path, help="write every finding here")
    asked = parser.parse_args()
    known = json.loads(asked.defects.read_text())["defects"]
    names = asked.adapters or sorted({defect["adapter"] for defect in known})
    findings = audited([asked.checkout / "policy" / name for name in names])
    print(f"{'adapter':<20} {'defects':>7} {'found':>5} {'fails':>5} {'warns':>5}")
    total = 0
    missed: list[dict[str, Any]] = []
    for name in names:
        own = [found for found in findings if found["adapter"] == name]
        verified = [defect for defect in known if defect["adapter"] == name]
        missed += (lost := [defect for defect in verified if not any(is_about(found, defect) for found in own)])
        fails = sum(found["outcome"] == "fail" for found in own)
        print(f"{name:<20} {len(verified):>7} {len(verified) - len(lost):>5} {fails:>5} {len(own) - fails:>5}")
        total += len(verified)
    print(f"{total - len(missed)} of {total} verified defects found; {len(findings)} findings in all")
    for defect in missed:
        print(f"missed: {defect['file']}:{defect['line']}: {defect['defect_class']}")
    if asked.json:
        asked.json.write_text(json.dumps(findings, indent=1))
    return 0


def audited(adapters: list[Path]) -> list[dict[str, Any]]:
    """Return every finding of the static gate on these adapters, with its adapter and outcome."""
    command = [sys.executable, "-m", "xpl_cli", "audit", *map(str, adapters)]
    done = subprocess.run(
        [*command, "--gate", "static", "--no-cache", "--format", "json"], check=False, capture_output=True, text=True
    )
    return [
        {"adapter": target["name"], "code": result["code"], "outcome": result["outcome"], **finding}
        for target in json.loads(done.stdout)["targets"]
        for gate in target["gates"]
        for result in gate["results"]
        for finding in result["findings"]
    ]


def is_about(found: dict[str, Any], defect: dict[str, Any]) -> bool:
    """Tell whether a finding is about a verified defect."""
    starts = [start for start in ABOUT if defect["defect_class"].startswith(start)]
    if not starts or int(found["code"][3:]) not in ABOUT[max(starts, key=len)]:
        return False
    if found["path"] is None:
        return Path(str(defect["file"])).name in found["message"]
    if not str(found["path"]).endswith(str(defect["file"]).split("/", 1)[1]):
        return False
    return found["code"] in ANYWHERE or abs((found["line"] or 0) - (defect["line"] or 0)) <= NEAR


if __name__ == "__main__":
    sys.exit(main())
