"""Take the arguments of RoboTwin's scripts/eval_policy.sh, and run its loop with a mock and a policy server.

Run as a program. It writes no result file; stdout says how far episodes came.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def main(words: list[str]) -> int:
    """Run some seeds and print how they ended."""
    from xpl import Client, get_embodiment
    from xpl.environment import read_manifest
    from xpl.process.modules import load_module

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task_name", required=True)
    parser.add_argument("--action_type", default="joint")
    parser.add_argument("--host", required=True)
    parser.add_argument("--port", required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--test_num", type=int, default=1)
    arguments = parser.parse_args(words)
    package = load_module(HERE / "loop.py").__package__
    loop, stand_in = (importlib.import_module(f"{package}.{name}") for name in ("loop", "stand_in"))
    facts = read_manifest(HERE)
    options = loop.EvalOptions(
        arguments.task_name, action_type=arguments.action_type, seed=arguments.seed, test_num=arguments.test_num
    )
    trial, case = f"{arguments.task_name}-{arguments.seed}", f"{arguments.task_name}-case"
    with Client(f"ws://{arguments.host}:{arguments.port}", trial_id=trial, action_case_id=case) as client:
        robot = get_embodiment(facts.embodiments[0])
        played = loop.evaluate(stand_in.MockSource(), client, options, robot, facts.cameras)
    results = [{**one, "success": None} for one in played.episodes]
    print(json.dumps({"stand_in": True, "episodes": results, "skipped": played.skipped}))  # noqa: T201 - its answer
    return 1 if any(one["error"] for one in results) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
