"""`xpl eval`: real servers and environments, thin scripts, the line that launchers wait for."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from tests.support import commands
from tests.support.adapters import drill
from tests.support.checkout import ROOT
from tests.support.peer import xpl
from tests.support.recordings.runs import episode
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.runs import quick_eval
from xpl_cli.evaluation.runs.evaluation import EvalSetup, Evaluation
from xpl_cli.evaluation.runs.settings import with_robot
from xpl_cli.packages import environments, package
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from xpl_cli.serving.launch import RunningServer


@pytest.mark.slow
def test_the_expert_solves_all_episodes_of_each_task_and_the_demo_policy_none(tmp_path: Path) -> None:
    """The tasks are solvable, and not by standing still; one server serves both, and seeds restart with each."""
    tasks = ["lift_cube", "handover_block"]
    options = ["--env", "mujoco", "--task", ",".join(tasks), "--json"]
    for policy, count, won in (("scripted_expert", 5, 10), ("demo_policy", 1, 0)):
        done = xpl("eval", policy, *options, "--episodes", str(count), cwd=tmp_path)
        assert done.returncode == ExitCode.CLEAN, done.stderr
        report = json.loads(done.stdout)
        assert validate(report, "evaluation") == []
        assert (report["task"], report["successes"]) == (",".join(tasks), won)
        played = [(episode["task"], episode["seed"]) for episode in report["episodes"]]
        assert played == [(task, seed) for task in tasks for seed in range(count)]


@pytest.mark.slow
def test_the_scripts_of_a_scaffold_run_a_debug_evaluation(tmp_path: Path) -> None:
    """eval.sh with the ten positional arguments of the ecosystem ends with the line that launchers expect."""
    assert xpl("new-policy", "Foo", cwd=tmp_path).returncode == ExitCode.CLEAN
    tool = tmp_path / "xpl"
    tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m xpl_cli "$@"\n')
    tool.chmod(0o755)
    arguments = ["my bench", "echo", "ckpt", "arx_x5", "joint", "0", "0", "0", "none", "none"]
    environment = {**os.environ, "EVAL_ENV_TYPE": "debug", "XPL": str(tool)}
    done = subprocess.run(
        ["/bin/bash", str(tmp_path / "policy/Foo/eval.sh"), *arguments],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[MAIN] eval finished"


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--env", "mujoco", "--task", "fold_shirt"], ExitCode.NOT_FOUND, "lift_cube"),
        (["--env", "isaac"], ExitCode.NOT_FOUND, "mujoco, offline"),
        (["--env", "mujoco", "--set", "env_cfg_type=franka"], ExitCode.USAGE, "has no franka"),
        (["--set", "seed"], ExitCode.USAGE, "KEY=VALUE"),
    ],
)
def test_what_cannot_be_evaluated_is_refused_in_one_sentence(
    tmp_path: Path, options: list[str], code: ExitCode, message: str
) -> None:
    done = commands.xpl("eval", "demo_policy", *options, folder=tmp_path)
    assert (done.code, done.stdout, commands.problem(done)) == (code, "", None)
    assert message in done.stderr


@pytest.mark.slow
def test_a_policy_whose_process_dies_in_every_attempt_has_failed(frail: Path, tmp_path: Path) -> None:
    """It is retried with a new server, as often as in a run, before that ends the evaluation."""
    drill.adapter(tmp_path)
    drill.mark(tmp_path, "policy-dies-0", 9)
    done = xpl("eval", "Drilled", *HOLD, cwd=tmp_path)
    answer = json.loads(done.stdout)
    assert (done.returncode, answer["schema"]) == (ExitCode.FINDINGS, "xpl.error/1")
    assert "SIGKILL" in answer["message"]
    assert (tmp_path / "policy-dies-0").read_text() == "6"


# -- environments in processes -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_record_of_an_episode_does_not_depend_on_who_plays_it(tmp_path: Path) -> None:
    """Seed, layout, wording, steps and digest are equal here and in other processes; the report is as specified."""
    scenario = [
        "--env",
        "mujoco",
        "--task",
        "lift_cube",
        "--setting",
        "randomized",
        "--episodes",
        "2",
        "--num-envs",
        "2",
    ]
    config = {"task": "lift_cube", "embodiment": "arx_x5", "num_envs": 2, "cameras": False, "setting": "randomized"}
    played = environments.make("mujoco", config)
    played.reset([0, 1])
    pairs = []
    for workers in (0, 2):
        options = ["--workers", str(workers), "--horizon", "5", "--json"]
        done = xpl("eval", "scripted_expert", *scenario, *options, cwd=tmp_path)
        assert done.returncode == ExitCode.CLEAN, done.stderr
        report = json.loads(done.stdout)
        assert validate(report, "evaluation") == []
        assert (report["setting"], report["horizon"], report["workers"]) == ("randomized", 5, workers)
        for record, fresh in zip(report["episodes"], played.results(), strict=True):
            fields = {key: record[key] for key in ("seed", "setting", "instruction", "layout")}
            assert fields == {key: fresh[key] for key in fields}
            assert (record["end_reason"], record["attempts"], record["corrections"]) == ("success", 1, {})
        pairs.append([[record[key] for key in ("steps", "digest")] for record in report["episodes"]])
    assert pairs[0] == pairs[1]


@pytest.fixture
def frail(tmp_path: Path) -> Path:
    """Return an environment that does not enforce its robot's limits."""
    folder = drill.environment(tmp_path)
    client = folder / "client.py"
    client.write_text(client.read_text().replace("guarded = True", "guarded = False"))
    return folder


HOLD = ["--env", "drill", "--set", "env_cfg_type=franka_single", "--json"]


WILD = """
    import numpy as np

    class Model:
        def __init__(self, config):
            self.config = config

        def reset(self): pass
        def update_obs(self, obs): self.state = obs["state"]
        def update_obs_batch(self, obs_list): self.update_obs(obs_list[-1])
        def get_action_batch(self, env_idx_list=None): return [self.get_action() for _ in env_idx_list]

        def get_action(self):
            far = self.state["arm_joint_state"] + np.float32(self.config["far"])
            return [{"arm_joint_state": far, "ee_joint_state": self.state["ee_joint_state"]}]
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("loop", "far", "reason", "kind"),
    [
        ([], "1.0", "far_first_action", "far_first_action"),
        (["--horizon", "1"], ".nan", "non_finite_action", "non_finite_action"),
        (["--horizon", "1"], "0.1", "success", "joint_speed"),
    ],
    ids=["far", "nan", "fast"],
)
def test_what_does_not_keep_its_limits_is_guarded(  # noqa: PLR0917 - fixtures and parameters
    frail: Path, write_adapter: Callable[..., Path], tmp_path: Path, loop: list[str], far: str, reason: str, kind: str
) -> None:
    """In either loop; the record has the corrections, where and how far."""
    adapter = write_adapter(WILD)
    shutil.copy(ROOT / "policy" / "demo_policy" / "deploy.py", adapter)
    done = xpl("eval", str(adapter), *HOLD, *loop, "--set", f"far={far}", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    report = json.loads(done.stdout)
    assert validate(report, "evaluation") == []
    (record,) = report["episodes"]
    assert record["end_reason"] == reason
    assert record["safety"][kind]["where"] in ("arm_joint_state", "joint1", "joint4")
    assert report["corrections"][kind] == record["safety"][kind]["count"]


@pytest.mark.slow
def test_what_runs_in_real_time_is_driven_by_servers_that_ask_for_a_token_only(
    frail: Path, write_adapter: Callable[..., Path], serve: Callable[..., RunningServer], tmp_path: Path
) -> None:
    """Those that an evaluation starts do; another one is refused before the first step."""
    facts = json.loads((frail / "env.yml").read_text())
    (frail / "env.yml").write_text(json.dumps({**facts, "real_time": True}), encoding="utf-8")
    adapter = write_adapter(WILD)
    play = ("eval", str(adapter), *HOLD, "--horizon", "1", "--set", "far=0.0")
    own = xpl(*play, cwd=tmp_path)
    assert own.returncode == ExitCode.CLEAN, own.stderr
    other = xpl(*play, "--connect", serve(adapter, overrides={"far": 0.0}).url, cwd=tmp_path)
    assert other.returncode == ExitCode.USAGE
    assert "requires no token: start it with --token-file" in other.stderr


SLOW = WILD.replace("def get_action(self):", "def get_action(self):\n            import time; time.sleep(0.5)")


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("real_time", "expected"), [(True, drill.STEPS), (False, None)])
def test_actions_age_unless_the_environment_waits(
    frail: Path, write_adapter: Callable[..., Path], tmp_path: Path, *, real_time: bool, expected: int | None
) -> None:
    """A model that thinks for twelve control steps is too slow for a robot, and not for a simulation."""
    facts = json.loads((frail / "env.yml").read_text())
    (frail / "env.yml").write_text(json.dumps({**facts, "real_time": real_time}), encoding="utf-8")
    done = xpl("eval", str(write_adapter(SLOW)), *HOLD, "--horizon", "1", "--set", "far=0.0", cwd=tmp_path)
    assert json.loads(done.stdout)["corrections"].get("action_age") == expected


def test_an_adapter_without_a_loop_is_driven_with_a_horizon(
    frail: Path, write_adapter: Callable[..., Path], tmp_path: Path
) -> None:
    """deploy.py is needed only where it is what runs."""
    adapter = write_adapter(WILD)
    assert xpl("eval", str(adapter), *HOLD, "--set", "far=0.0", cwd=tmp_path).returncode == ExitCode.NOT_FOUND
    done = xpl("eval", str(adapter), *HOLD, "--set", "far=0.0", "--horizon", "3", cwd=tmp_path)
    assert json.loads(done.stdout)["successes"] == 1


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--setting", "dusty"], ExitCode.NOT_FOUND, "clean"),
        (["--eval-env", "venv:nowhere"], ExitCode.NOT_RUN, "nowhere/bin/python"),
    ],
)
def test_an_environment_that_cannot_run_is_reported_in_one_sentence(
    frail: Path, tmp_path: Path, options: list[str], code: ExitCode, message: str
) -> None:
    done = commands.xpl("eval", "demo_policy", *HOLD, *options, folder=tmp_path)
    assert (done.code, commands.problem(done)) == (code, None)
    answer = json.loads(done.stdout)
    assert (answer["schema"], answer["exit_code"]) == ("xpl.error/1", code)
    assert message in answer["message"]
    assert answer["message"] in done.stderr


@pytest.mark.slow
def test_the_environment_runs_in_the_python_it_is_given(frail: Path, tmp_path: Path) -> None:
    """`--eval-env` names an environment as `--policy-env` does; another one than ours needs a process."""
    python = tmp_path / "place" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\necho used >> "{tmp_path}/used"\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    options = [*HOLD, "--eval-env", f"venv:{tmp_path}/place"]
    refused = xpl("eval", "demo_policy", *options, "--workers", "0", cwd=tmp_path)
    assert refused.returncode == ExitCode.USAGE
    assert "at least one worker" in refused.stderr
    done = xpl("eval", "demo_policy", *options, cwd=tmp_path)
    assert json.loads(done.stdout)["successes"] == 1, done.stderr
    assert (tmp_path / "used").read_text() == "used\n"


# -- processes -------------------------------------------------------------------------------------------------------


CORES = len(os.sched_getaffinity(0))


@pytest.mark.parametrize(
    ("num_envs", "workers", "expected"),
    [
        *((None, "1", (1, 1)), (None, "0", (1, 0)), (None, "3", (3, 3)), (8, "2", (8, 2)), (8, "0", (8, 0))),
        *((None, "auto", (CORES, CORES)), (1, "auto", (1, 1)), (CORES + 5, "auto", (CORES + 5, CORES))),
        *((2, "3", None), (None, "many", None)),
    ],
)
def test_there_is_one_environment_for_each_worker_by_default(
    num_envs: int | None, workers: str, expected: tuple[int, int] | None
) -> None:
    if expected is None:
        with pytest.raises(UserError):
            quick_eval.num_envs_and_workers(num_envs, workers)
    else:
        assert quick_eval.num_envs_and_workers(num_envs, workers) == expected


SEES = """
    import numpy as np

    class Model:
        def __init__(self, config): pass
        def reset(self): pass
        def update_obs_batch(self, obs_list): self.update_obs(obs_list[-1])

        def update_obs(self, obs):
            self.state = obs["state"]
            sizes = {camera["color"].shape for camera in obs["vision"].values()}
            assert sizes == {(96, 128, 3)}, sizes

        def get_action(self):
            keys = ("arm_joint_state", "ee_joint_state")
            return [{key: np.asarray(self.state[key], np.float32) for key in keys}]
"""


def test_an_environment_renders_what_the_policy_declares(write_adapter: Callable[..., Path], tmp_path: Path) -> None:
    """Images have the declared size; if one environment cannot render all, the handshake names the wrong one."""
    adapter = write_adapter(SEES)
    manifest = {
        "spec": "v1",
        "inputs": {"required": ["vision.cam_head", "state.arm_joint_state"], "optional": [], "unused": []},
        "cameras": {"cam_head": {"width": 128, "height": 96, "exact": True}},
    }
    (adapter / "policy.yml").write_text(json.dumps(manifest), encoding="utf-8")
    options = ["--env", "offline", "--task", "echo", "--horizon", "1", "--set", "env_cfg_type=franka_single"]
    done = xpl("eval", str(adapter), *options, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr

    manifest["cameras"]["cam_wrist"] = {"width": 256, "height": 96, "exact": True}
    (adapter / "policy.yml").write_text(json.dumps(manifest), encoding="utf-8")
    done = xpl("eval", str(adapter), *options, cwd=tmp_path)
    assert done.returncode == ExitCode.USAGE
    assert "the policy needs cam_head 128 x 96, the environment has 256 x 96" in done.stderr


@pytest.mark.parametrize(
    ("environment", "robot"), [("metaworld", None), ("libero", "panda_libero"), ("maniskill", "panda_maniskill")]
)
def test_the_robot_is_the_first_that_policy_and_environment_both_have(environment: str, robot: str | None) -> None:
    """The policy's own first one if the environment has that; the user's choice takes precedence."""
    expert = package.load(ROOT / "policy" / "benchmark_expert")
    overrides = {} if robot is None else {"env_cfg_type": robot}
    assert with_robot(expert, environment, {"seed": 3}) == {"seed": 3, **overrides}
    assert with_robot(expert, environment, {"env_cfg_type": "aloha"}) == {"env_cfg_type": "aloha"}
    named = replace(expert, deploy={**expert.deploy, "env_cfg_type": "so100"})
    assert with_robot(named, environment, {}) == {}


def test_an_episode_with_an_infrastructure_error_in_every_attempt_counts_as_failed() -> None:
    """If no episode has a success, there is no rate."""
    won = episode()
    failed = episode(success=None, score=None, end_reason="infrastructure", failure="infrastructure")
    played = EvalSetup("Foo", "mujoco", "lift_cube", "clean", "arx_x5", "joint")
    evaluation = Evaluation(played, [won, failed])
    assert (evaluation.successes, evaluation.success_rate, evaluation.mean_score, evaluation.infrastructure_errors) == (
        1,
        0.5,
        0.5,
        1,
    )
    assert Evaluation(played, [failed]).success_rate is None
    assert validate(evaluation.as_json(), "evaluation") == []
