"""Environments that a policy answers per second, in batches of 1, 8 and 32: `update_obs` and `get_action` together.

    ./dev bench inference                                       policy/Tiny_VLA
    ./dev bench inference --policy policy/Foo --set ckpt_name=x

The policy runs in its own Python. Observations are noise of the sizes in policy.yml. `predict` is timed by itself, too:
the rest is conversion. Batches of all sizes take turns, so that a machine that changes its speed changes all of them
alike.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
BATCHES = (1, 8, 32)
WARM_UP = 2
INSIDE = "XPL_BENCH_INSIDE"


def observation(manifest: Mapping[str, Any], robot: Any, action_type: str, env: int) -> dict[str, Any]:
    """Return an observation of the environment `env`: zeros for a pose, and noise for pictures."""
    import numpy as np

    draw = np.random.default_rng(env)
    sizes = {name: (entry["height"] or 224, entry["width"] or 224) for name, entry in manifest["cameras"].items()}
    pictures = {name: draw.integers(0, 256, (*size, 3), dtype=np.uint8) for name, size in sizes.items()}
    return {
        "env_idx": env,
        "instruction": "Lift the red block off the table.",
        "state": {name: np.zeros(count, np.float32) for name, count in robot.dims(action_type).items()},
        "vision": {name: {"color": picture} for name, picture in pictures.items()},
    }


def measure(folder: Path, manifest: Mapping[str, Any], config: Mapping[str, Any], rounds: int) -> list[dict[str, Any]]:
    """Return a row for each size of a batch; runs in the policy's Python."""
    from xpl import get_embodiment
    from xpl.worker.loading import load_model_class

    model = load_model_class(folder)({**config, "manifest": manifest})
    robot = get_embodiment(config["env_cfg_type"])
    observations = [observation(manifest, robot, config["action_type"], env) for env in range(max(BATCHES))]
    predict, inside = model.predict, []

    def time_calls(*arguments: Any) -> Any:
        begun = time.perf_counter()
        answer = predict(*arguments)
        inside.append(time.perf_counter() - begun)
        return answer

    model.predict = time_calls
    spent: dict[int, list[tuple[float, float]]] = {size: [] for size in BATCHES}
    for _ in range(rounds + WARM_UP):
        for size in BATCHES:
            begun = time.perf_counter()
            model.update_obs_batch(observations[:size])
            model.get_action_batch(list(range(size)))
            spent[size].append((time.perf_counter() - begun, inside[-1]))
    rows = []
    for size, times in spent.items():
        whole, alone = (statistics.median(column) for column in zip(*times[WARM_UP:], strict=False))
        rates = {"per_second": round(size / whole, 1), "predict_per_second": round(size / alone, 1)}
        rows.append({"environments": size, **rates, "median_ms": round(1e3 * whole, 2)})
    return rows


def main() -> None:
    """Measure, and print a line for each size of a batch."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default=str(ROOT / "policy" / "Tiny_VLA"), help="folder of the package")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a key of deploy.yml")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--python", help="interpreter of the policy; that of policy.yml by default")
    parser.add_argument("--json", metavar="FILE", help="write the rows there, too")
    arguments = parser.parse_args()
    if INSIDE in os.environ:
        handed = json.loads(os.environ[INSIDE])
        print(json.dumps(measure(Path(arguments.policy), handed["manifest"], handed["config"], arguments.rounds)))
        return
    from xpl_cli.lifecycle import interpreter
    from xpl_cli.packages import package

    adapter = package.load(arguments.policy)
    handed = {"manifest": dict(adapter.manifest.data), "config": adapter.config(package.parse_overrides(arguments.set))}
    python = arguments.python or interpreter.resolve(adapter.path, adapter.manifest.environment)
    command = [python, __file__, "--policy", str(adapter.path), "--rounds", str(arguments.rounds)]
    environment = {**os.environ, INSIDE: json.dumps(handed), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(done.returncode)
    rows = json.loads(done.stdout)
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items()))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
