"""Take the arguments of RoboDojo's scripts/eval_policy.sh, and run its loop with the mock and a policy server.

Run as a program. It writes no result file; stdout says how far episodes came. It runs the adapter's deploy.py, so it is
a process of its own.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
NUM_ENVS = 10  # env_cfg/sim/sim_config.yml
STEP_LIM = 20  # as long as the ecosystem's debug client plays


def main(words: list[str]) -> int:
    """Run some layouts and print how they ended."""
    import yaml

    from xpl import Client
    from xpl import _spec as spec
    from xpl.environment import read_manifest
    from xpl.process.modules import load_module

    arguments = _arguments(words)
    folder = Path(arguments.policy_dir)
    # RoboDojo reads this from the deploy.yml beside the simulator, not from the server's.
    deploy_yml: dict[str, Any] = yaml.safe_load((folder / spec.File.DEPLOY_YML).read_text(encoding="utf-8")) or {}
    count = NUM_ENVS if deploy_yml.get(spec.Deploy.EVAL_BATCH) else 1
    package = load_module(HERE / "client.py").__package__
    task_env, loop = (importlib.import_module(f"{package}.{name}") for name in ("task_env", "loop"))
    config = {
        "task": arguments.task_name,
        "embodiment": arguments.env_cfg_type,
        "num_envs": count,
        "max_steps": arguments.step_lim,
        "cameras": [arguments.height, arguments.height * 4 // 3],
    }
    env = task_env.RoboDojoEnv(read_manifest(HERE), config)
    url = arguments.policy_server_url or f"ws://{arguments.host}:{arguments.port}"
    trial = f"{arguments.task_name}-{arguments.run_id}"
    case = f"{arguments.task_name}_case"
    with Client(url, evaluation_id=arguments.run_id, trial_id=trial, action_case_id=case) as client:
        deploy = load_module(folder / spec.File.DEPLOY_PY)
        episodes = loop.evaluate(env, deploy, client, range(arguments.episodes))
    print(json.dumps({"stand_in": True, spec.Deploy.EVAL_BATCH: count > 1, "episodes": episodes}))  # noqa: T201 - its answer
    return 0


def _arguments(words: list[str]) -> argparse.Namespace:
    from xpl import _spec as spec

    parser = argparse.ArgumentParser(description=__doc__)
    for name in (spec.Deploy.TASK_NAME, spec.Deploy.ENV_CFG_TYPE, spec.Deploy.POLICY_NAME, "policy_dir"):
        parser.add_argument(f"--{name}", required=True)
    for name in (
        spec.Deploy.BENCH_NAME,
        spec.Deploy.HOST,
        "port",
        spec.Deploy.PROTOCOL,
        "policy_server_url",
        spec.Deploy.EVAL_BATCH,
        "root_dir",
        "device_id",
    ):
        parser.add_argument(f"--{name}", default="")
    parser.add_argument("--additional_info", default="")
    parser.add_argument("--run_id", default="rehearsal")
    parser.add_argument("--seed", type=int, default=0, help="set of layouts; the mock has one")
    parser.add_argument("--episodes", type=int, default=1)
    parser.add_argument("--step_lim", type=int, default=STEP_LIM)
    parser.add_argument("--height", type=int, default=480, help="of pictures; RoboDojo's are 480 x 640")
    return parser.parse_args(words)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
