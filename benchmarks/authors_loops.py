"""The authors' own evaluation beside `xpl eval`: do the same commands reach the simulator?

A package with `authors_loop.py` runs the evaluation that its authors publish, from their pinned source. This script
runs it and `xpl eval` from the same seed, with the same tiny random checkpoint, and records in both what passes the
simulator's own `step` and the function through which the model is asked. The first difference names its cause: an
observation of the simulator, an input of the model, its result, or what becomes of that.

    python benchmarks/authors_loops.py --only LeRobot/aloha_act --policy-python PYTHON --eval-env venv:DIR

The authors' loop runs in the policy's Python, with the packages of the environment's behind it: both need the same
minor version of Python.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.authors_loops_bench.comparison import Reading, Recording, Verdict, compare
from xpl.manifest import PythonEnvironment
from xpl_cli.lifecycle import interpreter
from xpl_cli.packages.package import load

ROOT = Path(__file__).resolve().parent.parent
TAP = ROOT / "benchmarks" / "authors_loops_bench" / "tap"
PLAY = ROOT / "benchmarks" / "authors_loops_bench" / "play.py"
SIMULATORS = {
    "aloha": {"reset": "gym_aloha.env:AlohaEnv.reset", "step": "gym_aloha.env:AlohaEnv.step"},
    "metaworld": {
        "reset": "metaworld.sawyer_xyz_env:SawyerXYZEnv.reset",
        "step": "metaworld.sawyer_xyz_env:SawyerXYZEnv.step",
    },
    "libero": {
        "reset": "libero.libero.envs.env_wrapper:ControlEnv.reset",
        "place": "libero.libero.envs.env_wrapper:ControlEnv.set_init_state",
        "step": "libero.libero.envs.env_wrapper:ControlEnv.step",
    },
}
"""Of each environment package, the functions of the simulator that are recorded."""
READINGS = {"metaworld": Reading(largest=1.0), "libero": Reading(largest=1.0, signs=(-1,))}
"""What simulators make of a command before they use it, by environment."""
LIMIT_S = 3600.0
VARIABLE = "AUTHORS_LOOPS_TAPS"
"""Read by `tap/sitecustomize.py`."""


@dataclass(frozen=True)
class Loop:
    """One loop of a package's authors_loop.py.

    Attributes:
        package: folder of the policy.
        name: of the loop, which is the variant of policy.yml unless `facts` has another one.
        facts: its entry of LOOPS.
    """

    package: Path
    name: str
    facts: dict[str, Any]

    def __str__(self) -> str:
        """Return the name that `--only` takes."""
        return f"{self.package.name}/{self.name}"

    @property
    def taps(self) -> dict[str, str]:
        """The recorded functions by name."""
        return {**SIMULATORS[self.facts["environment"]], **self.facts["model"]}


@dataclass(frozen=True)
class Options:
    """How a loop is run.

    Attributes:
        checkpoint: folder of the tiny checkpoint.
        steps: of the simulator, those that wait for objects to settle included.
        seed: of the episode.
        policy_python: the policy's interpreter.
        eval_env: the environment's, as `xpl eval --eval-env` takes it.
        folder: for the recordings.
        our_policy, our_env: packages that `xpl eval` runs in place of the loop's, such as copies with a mistake.
        behind: packages of the simulator for the policy's Python; those of the environment's Python by default.
    """

    checkpoint: Path
    steps: int
    seed: int
    policy_python: str
    eval_env: str
    folder: Path
    our_policy: Path | None = None
    our_env: str | None = None
    behind: Path | None = None


def loops(root: Path = ROOT / "policy") -> list[Loop]:
    """Return the loops of all packages."""
    found = []
    for file in sorted(root.glob("*/authors_loop.py")):
        spec = importlib.util.spec_from_file_location(f"{file.parent.name}_authors_loop", file)
        if spec is None or spec.loader is None:
            continue
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        found += [Loop(file.parent, name, facts) for name, facts in module.LOOPS.items()]
    return found


def run(loop: Loop, options: Options) -> Verdict:
    """Run both loops and compare them."""
    theirs, ours = options.folder / "theirs", options.folder / "ours"
    if not theirs.exists():  # kept by `--keep`
        run_theirs(loop, options, theirs)
    shutil.rmtree(ours, ignore_errors=True)
    run_ours(loop, options, ours)
    reading, left_out = READINGS.get(loop.facts["environment"], Reading()), loop.facts.get("left_out", ())
    recordings = (Recording.of(each, reading, left_out) for each in (theirs, ours))
    return compare(*recordings, loop.facts.get("tolerance", 0.0))


def run_theirs(loop: Loop, options: Options, folder: Path) -> None:
    """Run the authors' loop in the policy's Python."""
    request = {
        "loop": loop.name,
        "config": config_of(loop, options),
        "seed": options.seed,
        "entropy": [0, 0, 0],  # of `Policy.rng` in the first episode: seed of the run, episode, environment
        "behind": [str(options.behind or _packages(options.eval_env)), str(ROOT)],
    }
    command = [options.policy_python, str(PLAY), str(loop.package), json.dumps(request)]
    _run(command, loop, options, folder, options.folder)


def run_ours(loop: Loop, options: Options, folder: Path) -> None:
    """Run `xpl eval`, whose processes inherit the taps; it ends early, as the taps end it."""
    command = [sys.executable, "-m", "xpl_cli", "eval", str(options.our_policy or loop.package)]
    command += ["--env", options.our_env or loop.facts["environment"]]
    command += ["--task", loop.facts["task"], "--setting", loop.facts["setting"], "--seed", str(options.seed)]
    command += ["--python", options.policy_python, "--eval-env", options.eval_env]
    for word in (f"ckpt_name={options.checkpoint}", *variant(loop)):
        command += ["--set", word]
    _run(command, loop, options, folder, ROOT)


def variant(loop: Loop) -> list[str]:
    """Return the `--set` that chooses the variant of a loop."""
    name = loop.facts.get("variant", loop.name)
    return [f"variant={name}"] if name else []


def config_of(loop: Loop, options: Options) -> dict[str, Any]:
    """Return deploy.yml after overrides."""
    package = load(loop.package, dict(word.split("=", 1) for word in variant(loop)))
    return {**package.deploy, "ckpt_name": str(options.checkpoint)}


def _run(command: list[str], loop: Loop, options: Options, folder: Path, cwd: Path) -> None:
    """Run a command with the taps, which end it by an error."""
    folder.mkdir(parents=True)
    taps = {"folder": str(folder), "taps": loop.taps, "steps": options.steps}
    paths = os.pathsep.join(filter(None, (str(TAP), os.environ.get("PYTHONPATH"))))
    log = folder.with_suffix(".log")
    with log.open("wb") as output:
        ours = {VARIABLE: json.dumps(taps), "PYTHONPATH": paths, "PYTHONUNBUFFERED": "1"}
        variables = {"MUJOCO_GL": "egl", "OMP_NUM_THREADS": "1", **os.environ, **ours}
        done = subprocess.run(
            command, cwd=cwd, env=variables, stdout=output, stderr=subprocess.STDOUT, check=False, timeout=LIMIT_S
        )
    steps = len(list(folder.glob("*-step.npz")))
    if steps < options.steps and (done.returncode or not steps):
        last = log.read_text(errors="replace").splitlines()[-12:]
        raise RuntimeError(f"{command[0]} ended with {done.returncode} after {steps} steps:\n" + "\n".join(last))


def _packages(eval_env: str) -> str:
    """Return the folder of the packages of the environment's Python."""
    python = interpreter.resolve(ROOT, PythonEnvironment(), env=eval_env)
    command = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def main() -> int:
    """Run loops and print a table; 1 if commands differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", required=True, help="a loop, such as LeRobot/aloha_act")
    parser.add_argument("--checkpoint", type=Path, required=True, help="of `xpl checkpoint tiny`")
    parser.add_argument("--policy-python", required=True, help="the policy's interpreter")
    parser.add_argument("--eval-env", required=True, help="the environment's, as of xpl eval: venv:DIR")
    parser.add_argument("--steps", type=int, default=60, help="of the simulator")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--our-policy", type=Path, help="a changed copy of the package, for a planted mistake")
    parser.add_argument("--our-env", help="of the environment package, likewise")
    parser.add_argument("--behind", type=Path, help="site-packages of the simulator for the policy's Python")
    parser.add_argument("--keep", type=Path, help="folder for the recordings, which are deleted otherwise")
    options = parser.parse_args()
    loop = next(each for each in loops() if str(each) == options.only)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if options.keep is None else options.keep
        chosen = Options(
            options.checkpoint.resolve(),
            options.steps,
            options.seed,
            options.policy_python,
            options.eval_env,
            folder.resolve(),
            options.our_policy,
            options.our_env,
            options.behind,
        )
        verdict = run(loop, chosen)
    print(f"{loop}, seed {options.seed}: {verdict}")
    return 0 if verdict.agree else 1


if __name__ == "__main__":
    sys.exit(main())
