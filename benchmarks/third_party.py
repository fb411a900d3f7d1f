"""Speed of other benchmarks here, beside their own bare loops.

The same commands run through the environment package (reading the action, limits, conversion, observation, digest,
judging) and through the benchmark's own `step`, by turns, in the benchmark's own Python; processor time of a control
step, without resets, and of each step the median of all rounds counts. With cameras: two or three of 128 x 128 by both.
`experts` runs episodes of Meta-World's scripted policies and of ManiSkill's planners through the server. What is not
installed is `not_run`, with the reason.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from xpl_cli.basics.errors import UserError
from xpl_cli.lifecycle import interpreter
from xpl_cli.packages import environments

ROOT = Path(__file__).resolve().parent.parent
PROGRAM = ROOT / "benchmarks" / "third_party_bench" / "side_by_side.py"
NAMES = ("metaworld", "libero", "aloha", "maniskill", "robosuite")
STEPS = {  # of one round, without and with cameras
    "metaworld": {False: 400, True: 40},
    "libero": {False: 150, True: 40},
    "aloha": {False: 250, True: 20},
    "maniskill": {False: 300, True: 30},
    "robosuite": {False: 150, True: 40},
}
LEAST = {False: 0.9, True: 0.95}
TEN = (
    *("reach", "push", "pick-place", "door-open", "drawer-open", "button-press-topdown", "peg-insert-side"),
    *("window-open", "assembly", "basketball"),
)
PLANNED = ("PickCube", "StackCube", "PushCube", "PullCubeTool")
PLAYED = {
    **dict.fromkeys(TEN, ("metaworld",)),
    **dict.fromkeys(PLANNED, ("maniskill", "--setting", "planner", "--set", "action_type=joint")),
}
"""Tasks of the experts, with the environment and further options."""
LIMIT_S = 1800.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=NAMES, help="one benchmark")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--experts", type=int, default=0, metavar="N", help="episodes of each expert's tasks")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    options = parser.parse_args()
    print(f"{'benchmark':<12} {'cameras':>8} {'ours ms':>9} {'bare ms':>9} {'ratio':>6} {'target':>7}")
    rows = [
        _row(name, options.rounds, is_drawn=is_drawn)
        for name in ([options.only] if options.only else NAMES)
        for is_drawn in (False, True)
    ]
    experts = (
        [_experts(task, options.experts) for task, (name, *_) in PLAYED.items() if options.only in (None, name)]
        if options.experts
        else []
    )
    if options.json is not None:
        options.json.write_text(json.dumps({"rows": rows, "experts": experts}, indent=2) + "\n")


def _row(name: str, rounds: int, *, is_drawn: bool) -> dict[str, Any]:
    row: dict[str, Any] = {"benchmark": name, "cameras": is_drawn, "target": LEAST[is_drawn]}
    folder = ROOT / "envs" / name
    facts = environments.manifest(folder)
    try:
        python = interpreter.resolve(folder, facts.environment)
        words = (facts.embodiments[0], "cameras" if is_drawn else "none", STEPS[name][is_drawn], rounds)
        row.update(_run_json([python, str(PROGRAM), name, *map(str, words)]))
    except UserError as error:
        row["not_run"] = str(error)
    if "not_run" in row:
        print(f"{name:<12} not_run: {row['not_run']}")
    else:
        figures = f"{row['ours_ms']:>9.2f} {row['bare_ms']:>9.2f} {row['ratio']:>6.2f} {row['target']:>7}"
        print(f"{name:<12} {'yes' if is_drawn else 'no':>8} {figures}", flush=True)
    return row


def _experts(task: str, episodes: int) -> dict[str, Any]:
    name, *options = PLAYED[task]
    command = [sys.executable, "-m", "xpl_cli", "eval", "policy/benchmark_expert", "--env", name, "--task", task]
    answer = _run_json([*command, *options, "--episodes", str(episodes), "--json"])
    played = answer.get("episodes", [])
    row = {"task": task, "episodes": len(played), "solved": sum(bool(each["success"]) for each in played)}
    print(f"{task:<24} {row['solved']} of {row['episodes']}", flush=True)
    return row


def _run_json(command: list[str]) -> dict[str, Any]:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    if done.returncode:
        return {"not_run": (done.stderr.strip().splitlines() or ["no word"])[-1]}
    answer: dict[str, Any] = json.loads(done.stdout if "--json" in command else done.stdout.splitlines()[-1])
    return answer


if __name__ == "__main__":
    main()
