"""Verified defects of public adapters that the static gate finds, by the rules for their class.

    python benchmarks/static_recall.py CHECKOUT DEFECTS [ADAPTER...] [--json FILE]

CHECKOUT is a clone of the ecosystem's repository. DEFECTS is a JSON file with verified defects; `verified.py` defines
its form, and when one counts as found. Nothing of the adapters is run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.verified import is_about


def main() -> int:
    """Audit, and print a line for each adapter and each defect that was not found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("checkout", type=Path)
    parser.add_argument("defects", type=Path)
    parser.add_argument("adapters", nargs="*", help="names; all that have verified defects if none is given")
    parser.add_argument("--json", type=Path, help="write every finding here")
    arguments = parser.parse_args()
    defects = json.loads(arguments.defects.read_text())["defects"]
    names = arguments.adapters or sorted({defect["adapter"] for defect in defects})
    findings = audit_adapters([arguments.checkout / "policy" / name for name in names])
    print(f"{'adapter':<20} {'defects':>7} {'found':>5} {'fails':>5} {'warns':>5}")
    total = 0
    missed: list[dict[str, Any]] = []
    for name in names:
        own = [finding for finding in findings if finding["adapter"] == name]
        verified = [defect for defect in defects if defect["adapter"] == name]
        missed += (lost := [defect for defect in verified if not any(is_about(finding, defect) for finding in own)])
        fails = sum(finding["outcome"] == "fail" for finding in own)
        print(f"{name:<20} {len(verified):>7} {len(verified) - len(lost):>5} {fails:>5} {len(own) - fails:>5}")
        total += len(verified)
    print(f"{total - len(missed)} of {total} verified defects found; {len(findings)} findings in all")
    for defect in missed:
        print(f"missed: {defect['file']}:{defect['line']}: {defect['defect_class']}")
    if arguments.json:
        arguments.json.write_text(json.dumps(findings, indent=1))
    return 0


def audit_adapters(adapters: list[Path]) -> list[dict[str, Any]]:
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


if __name__ == "__main__":
    sys.exit(main())
