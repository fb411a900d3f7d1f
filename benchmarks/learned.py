"""Record, prepare, train and judge a policy of docs/learned-policies.md with the settings of its training.

    ./dev bench learned                                          the recipes
    ./dev bench learned --policy ACT --task lift_cube            a GPU, and some minutes
    ./dev bench learned --policy ACT:state --task mw-push        two cores, the variant `state`

Everything lies in results/learned/POLICY-TASK, the checkpoint in the package. The same command continues an interrupted
run: recording and judging episode by episode, training at its last save. result.json is written when all is done.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from xpl_cli.basics import atomic

ROOT = Path(__file__).resolve().parent.parent
XPL = [sys.executable, "-m", "xpl_cli"]
CLEAN, RANDOMIZED = "clean", "randomized"


@dataclass(frozen=True)
class Recipe:
    """How a policy of the table was trained, and is judged.

    Attributes:
        environment, task, robot: of the rollouts.
        record: by setting, the number of episodes that the environment's expert records.
        images: of the demonstrations; None: none, but privileged observations instead.
        train: keys of deploy.yml.
        action_type: of the demonstrations and of the policy.
        horizon: execution horizon when it is judged; None: the whole chunk.
        judged: settings that it is judged in; behind a colon the value of `--instruction`.
    """

    environment: str
    task: str
    robot: str
    record: Mapping[str, int]
    images: str | None
    train: Mapping[str, float]
    action_type: str = "ee"
    horizon: int | None = None
    judged: tuple[str, ...] = (CLEAN,)


def _ours(task: str, *, images: bool, horizon: int | None = None, **train: float) -> Recipe:
    record = {CLEAN: 130, RANDOMIZED: 130} if images else {CLEAN: 260}
    judged = (CLEAN, RANDOMIZED) if images else (CLEAN,)
    image_size = "96x96" if images else None
    return Recipe("mujoco", task, "arx_x5_single", record, image_size, train, horizon=horizon, judged=judged)


def _metaworld(task: str, **train: float) -> Recipe:
    return Recipe("metaworld", task, "sawyer", {CLEAN: 50}, None, {"batch": 64, "noise": 0.02, **train})


RECIPES: dict[tuple[str, str], Recipe] = {
    ("Tiny_VLA", "pick_by_language"): Recipe(
        "mujoco",
        "pick_by_language",
        "arx_x5_single",
        {CLEAN: 720, RANDOMIZED: 720},
        "96x96",
        {"batch": 256, "steps": 4000},
        action_type="joint",
        judged=(CLEAN, RANDOMIZED, f"{CLEAN}:swap", f"{RANDOMIZED}:swap", f"{CLEAN}:blank"),
    ),
    ("ACT", "lift_cube"): _ours("lift_cube", images=True, batch=64, noise=0.01, steps=4050),
    ("ACT", "push_block"): _ours("push_block", images=True, batch=128, noise=0.01, steps=5692),
    ("DiffusionPolicy", "lift_cube"): _ours("lift_cube", images=True, batch=256, noise=0.03, steps=4961),
    ("DiffusionPolicy", "push_block"): _ours("push_block", images=True, batch=256, noise=0.03, steps=4998),
    ("ACT:state", "lift_cube"): _ours("lift_cube", images=False, batch=64, noise=0.01, steps=8850),
    ("ACT:state", "push_block"): _ours("push_block", images=False, batch=64, noise=0.01, steps=9250),
    ("DiffusionPolicy:state", "lift_cube"): _ours(
        "lift_cube", images=False, horizon=1, batch=256, noise=0.02, steps=9057
    ),
    ("DiffusionPolicy:state", "push_block"): _ours(
        "push_block", images=False, horizon=1, batch=256, noise=0.02, steps=9183
    ),
    ("ACT", "stack_blocks_two"): _ours("stack_blocks_two", images=True, batch=128, noise=0.01, steps=5196),
    ("DiffusionPolicy", "stack_blocks_two"): _ours("stack_blocks_two", images=True, batch=256, noise=0.03, steps=3843),
    ("ACT:state", "stack_blocks_two"): _ours("stack_blocks_two", images=False, batch=256, noise=0.01, steps=13449),
    ("DiffusionPolicy:state", "stack_blocks_two"): _ours(
        "stack_blocks_two", images=False, horizon=1, batch=256, noise=0.02, steps=8621
    ),
    **{
        (policy, f"mw-{task}"): _metaworld(task, steps=steps)
        for policy, tasks in {
            "ACT:state": {
                "push": 11932,
                "pick-place": 11635,
                "door-open": 11813,
                "drawer-open": 11090,
                "peg-insert-side": 12454,
            },
            "DiffusionPolicy:state": {
                "push": 5562,
                "pick-place": 5350,
                "door-open": 5305,
                "drawer-open": 5333,
                "peg-insert-side": 5114,
            },
        }.items()
        for task, steps in tasks.items()
    },
}


@dataclass(frozen=True)
class Stage:
    """One command.

    Attributes:
        name: of the stage, recorded when it is done.
        words: arguments of `xpl`.
        good: exit codes that mean done.
        begun: a file that exists once it has begun: then it continues.
    """

    name: str
    words: tuple[str, ...]
    good: tuple[int, ...] = (0,)
    begun: Path | None = None


def stages(recipe: Recipe, package: Path, out: Path, arguments: argparse.Namespace) -> Iterator[Stage]:
    """Yield the commands of a recipe, in their order.

    Args:
        recipe: what is made.
        package: folder of the policy.
        out: folder of demonstrations, runs and report.
        arguments: the command line.
    """
    sees = ("--images", recipe.images, "--quality", "90", "--no-depth") if recipe.images else ("--images", "none")
    demos = {setting: out / "demos" / setting for setting in recipe.record}
    where = () if arguments.eval_env is None else ("--eval-env", arguments.eval_env)
    robot = ("--task", recipe.task, "--embodiment", recipe.robot, "--action-type", recipe.action_type)
    for setting, count in recipe.record.items():
        words = ("record", recipe.environment, *robot, "--setting", setting, "--episodes", str(count), *sees)
        more = ("--privileged", "--workers", arguments.workers, "--out", str(demos[setting]), *where)
        yield Stage(f"record {setting}", (*words, *more), begun=demos[setting] / "run" / "records.jsonl")
    if not arguments.installed:
        yield Stage("install", ("install", str(package)))
    sets = json.dumps([str(demo) for demo in demos.values()])
    keys = {"ckpt_name": arguments.name, "env_cfg_type": recipe.robot, "demonstrations": sets, **recipe.train}
    chosen = ("--set", f"variant={arguments.variant}") if arguments.variant else ()
    settings = tuple(word for key, value in keys.items() for word in ("--set", f"{key}={value}")) + chosen
    yield Stage("prepare", ("prepare", str(package), *settings))
    yield Stage("train", ("train", str(package), *settings))
    whole = () if recipe.horizon is None else ("--horizon", str(recipe.horizon))
    for judged in recipe.judged:
        setting, _, instruction = judged.partition(":")
        run = _run(out, judged)
        words = ("eval", str(package), "--env", recipe.environment, "--task", recipe.task, "--setting", setting)
        instruction_option = ("--instruction", instruction) if instruction else ()
        how = (
            "--episodes",
            str(arguments.judge),
            "--workers",
            arguments.workers,
            "--film",
            "0",
            *instruction_option,
            *whole,
            *where,
        )
        which = ("--set", f"ckpt_name={arguments.name}", "--set", f"env_cfg_type={recipe.robot}", *chosen)
        yield Stage(f"judge {judged}", (*words, *how, *which, "--out", str(run)), (0, 1), begun=run / "records.jsonl")
        yield Stage(f"report {judged}", ("report", str(run)))


def _run(out: Path, judged: str) -> Path:
    return out / "runs" / judged.replace(":", "-")


def write(file: Path, value: Any) -> None:
    """Write JSON that is there whole or not at all."""
    atomic.write_file(file.resolve(), (json.dumps(value, indent=2) + "\n").encode())


def run(recipe: Recipe, arguments: argparse.Namespace) -> dict[str, Any]:
    """Do what is not done yet, and return the result.

    Raises:
        SystemExit: a command failed, or the folder holds what was made otherwise.
    """
    package = Path(arguments.package or ROOT / "policy" / arguments.policy.partition(":")[0]).resolve()
    name = f"{arguments.policy.replace(':', '-')}-{arguments.task}"
    out = Path(arguments.out or ROOT / "results" / "learned" / name).resolve()
    out.mkdir(parents=True, exist_ok=True)
    settings = {**asdict(recipe), "policy": arguments.policy, "package": str(package), "checkpoint": arguments.name}
    settings = json.loads(json.dumps({**settings, "episodes_judged": arguments.judge}))
    file = out / "state.json"
    state = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {"settings": settings, "seconds": {}}
    if state["settings"] != settings:
        sys.exit(f"{out} was begun with other settings ({file}): go on with those, or name another folder with --out")
    write(file, state)
    all_stages = list(stages(recipe, package, out, arguments))
    for number, stage in enumerate(all_stages, 1):
        if stage.name in state["seconds"]:
            continue
        resumed = ("--resume",) if stage.begun is not None and stage.begun.exists() else ()
        print(f"== {number} of {len(all_stages)}: {stage.name}", file=sys.stderr, flush=True)
        begun = time.monotonic()
        command = [*XPL, *stage.words, *resumed]
        code = subprocess.run(command, env=_variables(), stdout=sys.stderr, check=False).returncode
        if code not in stage.good:
            sys.exit(f"{stage.name} ended with exit code {code}; the same command goes on there")
        state["seconds"][stage.name] = round(time.monotonic() - begun, 1)
        write(file, state)
    report_files = {judged: _run(out, judged) / "report" / "report.json" for judged in recipe.judged}
    reports = {judged: json.loads(path.read_text(encoding="utf-8")) for judged, path in report_files.items()}
    return {"schema": "xpl.learned/1", **state, "reports": reports, "out": str(out)}


def _variables() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))}


def parse_arguments(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the parsed arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", choices=sorted({policy for policy, _ in RECIPES}), help="POLICY or POLICY:VARIANT")
    parser.add_argument("--task", help="as in the list; mw- for those of Meta-World")
    parser.add_argument("--out", help="folder; results/learned/POLICY-TASK by default")
    parser.add_argument("--name", help="of the checkpoint; learned-TASK or learned-VARIANT-TASK by default")
    parser.add_argument("--package", help="folder of the policy; the one in policy/ by default")
    parser.add_argument("--installed", action="store_true", help="leave `xpl install` out")
    parser.add_argument("--eval-env", help="Python of the environment, as for `xpl eval`")
    parser.add_argument("--workers", default="auto", help="episodes at once (default: auto, one a core)")
    parser.add_argument("--judge", type=int, default=50, metavar="N", help="episodes of each setting (default: 50)")
    parser.add_argument("--episodes", type=int, metavar="N", help="demonstrations of each setting, to try it out")
    parser.add_argument("--steps", type=int, metavar="N", help="of the training, to try it out")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result there, too")
    options = parser.parse_args(arguments)
    if (options.policy is None) != (options.task is None):
        parser.error("--policy and --task go together; without both what there is is listed")
    if options.policy is not None and (options.policy, options.task) not in RECIPES:
        tasks = ", ".join(task for policy, task in RECIPES if policy == options.policy)
        parser.error(f"{options.policy} was not trained on {options.task}: {tasks}")
    options.variant = (options.policy or "").partition(":")[2]
    if options.name is None:
        options.name = "-".join(filter(None, ("learned", options.variant, options.task)))
    return options


def apply_arguments(recipe: Recipe, arguments: argparse.Namespace) -> Recipe:
    """Return a recipe with the numbers that the command line has for it."""
    if arguments.episodes is not None:
        recipe = replace(recipe, record=dict.fromkeys(recipe.record, arguments.episodes))
    return recipe if arguments.steps is None else replace(recipe, train={**recipe.train, "steps": arguments.steps})


def main() -> None:
    """List the recipes, or follow one."""
    arguments = parse_arguments()
    if arguments.policy is None:
        for (policy, task), recipe in RECIPES.items():
            settings = "  ".join(f"{key} {value:g}" for key, value in recipe.train.items())
            print(f"--policy {policy} --task {task}".ljust(58), f"{sum(recipe.record.values())} episodes  {settings}")
        return
    result = run(apply_arguments(RECIPES[arguments.policy, arguments.task], arguments), arguments)
    files = [Path(result["out"]) / "result.json", *([] if arguments.json is None else [arguments.json])]
    for file in files:
        write(file, result)
    print(files[0])


if __name__ == "__main__":
    main()
