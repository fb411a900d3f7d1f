"""Speed of the MuJoCo environment, beside raw `mj_step`, gym-aloha, gymnasium-robotics and robosuite.

Physics: the expert's episode of every task, replayed by the environment (reading the action, limits, physics,
digest, judging the task) and by as many physics steps of `mj_step` alone from the same state with the same controls,
in processor time. Alternatives are measured in turn, and the median round counts. The environments' control steps
hold the pose. Episodes are of 10 simulated seconds, reset included, so that tasks of different length compare; `x real
time` is simulated by processor time. Peers run on their nearest task in environments of their own, made on first use
from `environments_bench/locks`; one that cannot be made or run here is `not_run`, with the reason.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.environments_bench import ours
from benchmarks.serving_bench.environments import BuildError, python_of

ROOT = Path(__file__).resolve().parent.parent
HERE = ROOT / "benchmarks" / "environments_bench"
PEERS = ("gym-aloha", "gymnasium-robotics", "robosuite")
TASKS = (("lift_cube", "joint"), ("handover_block", "joint"), ("handover_block", "ee"))
RENDERERS = (ours.RAYCAST, "egl", "osmesa")
LEAST_RATIO = 0.8
MOST_MS = {(224, 224): 10.0, (480, 640): 60.0}
EPISODE_S = 10.0
FEW_ROUNDS = 15
"""Of what takes long: whole episodes, and pictures."""
PROCESS_S = 300.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-peers", action="store_true", help="our environment only")
    parser.add_argument("--rounds", type=int, default=101, help="of each measurement at the most (default: 101)")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    options = parser.parse_args()
    few = min(options.rounds, FEW_ROUNDS)
    physics = _physics(few)
    rows: list[dict[str, Any]] = [
        {"environment": "xpl mujoco", **ours.figures(*task, options.rounds)} for task in TASKS
    ]
    cameras = _cameras(TASKS[1][0], few)
    peers = [] if options.no_peers else [{"environment": name, **_peer(name)} for name in PEERS]
    fastest = min(row["ms"] for row in cameras if row["ms"] is not None and row["size"] == ours.SIZES[0])
    rows = [{**row, "pictures": "3x224x224", "picture_ms": fastest} for row in rows]
    _show_environments([*rows, *peers])
    if options.json is not None:
        figures = {"physics": physics, "cameras": cameras, "environments": [*rows, *peers]}
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


def _physics(rounds: int) -> list[dict[str, Any]]:
    """Measure and print every task's physics."""
    print(f"{'physics':<34} {'control us':>10} {'mj_step us':>10} {'ratio':>6}   target {LEAST_RATIO} in joint control")
    rows: list[dict[str, Any]] = []
    for task, action_type in (*((task, "joint") for task in ours.tasks()), TASKS[-1]):
        row: dict[str, Any] = {"task": f"{task}, {ours.ROBOT}, {action_type}"}
        try:
            row.update(ours.physics(task, action_type, rounds))
            act, raw = 1e3 * row["act_ms"], 1e3 * row["raw_ms"]
            print(f"{row['task']:<34} {act:>10.0f} {raw:>10.0f} {raw / act:>6.2f}")
        except RuntimeError as error:
            row["not_run"] = str(error)
            print(f"{row['task']:<34} not_run: {error}")
        rows.append(row)
    return rows


def _cameras(task: str, rounds: int) -> list[dict[str, Any]]:
    """Measure and print three cameras by renderer and size."""
    print(f"\n{'three cameras of ' + task:<34} {'renderer':>9} {'ms':>8} {'target':>9}")
    rows = []
    for size in ours.SIZES:
        for renderer in RENDERERS:
            name, goal = f"{size[0]}x{size[1]}", MOST_MS[size]
            command = [sys.executable, "-m", ours.__name__, task, renderer, *map(str, (*size, rounds))]
            row: dict[str, Any] = {"size": size, "renderer": renderer, "ms": None, **_figures_of(command, {})}
            if row["ms"] is None:
                note = f" not_run: {row['not_run']}"
            elif renderer == ours.RAYCAST:
                note = f"{row['ms']:>8.1f} {'met' if row['ms'] < goal else 'missed':>9}"
            else:
                note = f"{row['ms']:>8.1f}"
            print(f"{name:<34} {renderer:>9} {note}")
            rows.append(row)
    return rows


def _peer(name: str) -> dict[str, Any]:
    """Return a peer's figures, or why there are none."""
    try:
        command = [python_of(name, HERE / "locks"), str(HERE / "peer.py"), name]
        return _figures_of(command, {"MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")})  # draw without a window
    except BuildError as error:
        return {"not_run": str(error)}


def _figures_of(command: list[str], variables: dict[str, str]) -> dict[str, Any]:
    """Return what a process prints as its last line, a JSON object, or why it did not."""
    try:
        done = subprocess.run(
            command,
            check=False,
            capture_output=True,
            text=True,
            timeout=PROCESS_S,
            cwd=ROOT,
            env={**os.environ, **variables},
        )
    except subprocess.TimeoutExpired as error:
        return {"not_run": str(error)}
    if done.returncode:
        return {"not_run": (done.stderr.strip().splitlines() or ["it failed"])[-1]}
    figures: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return figures


def _show_environments(rows: list[dict[str, Any]]) -> None:
    print("\nsteps: control steps with the observed state; pictures: those of one observation")
    head = ("environment", "task", "Hz", "mj_step/step", "steps/s", "x real time", "episodes/h", "pictures", "ms")
    widths = (19, 29, 4, 13, 8, 12, 11, 10, 7)
    print(" ".join(f"{text:<{width}}" for text, width in zip(head, widths, strict=True)))
    for row in rows:
        if "not_run" in row:
            print(f"{row['environment']:<{widths[0]}} not_run: {row['not_run']}")
            continue
        step, steps = row["step_ms"], EPISODE_S * row["hz"]
        cells = (
            row["environment"],
            row["task"],
            row["hz"],
            f"{row['raw_ms'] / step:.2f}",
            f"{1e3 / step:.0f}",
            f"{1e3 / step / row['hz']:.0f}",
            f"{3.6e6 / (row['reset_ms'] + steps * step):.0f}",
            row["pictures"] or "-",
            "-" if row["picture_ms"] is None else f"{row['picture_ms']:.1f}",
        )
        print(" ".join(f"{cell!s:<{width}}" for cell, width in zip(cells, widths, strict=True)))


if __name__ == "__main__":
    main()
