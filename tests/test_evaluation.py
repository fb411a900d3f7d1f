"""`xpl eval`: real servers and environments, thin scripts, the line that launchers wait for."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.peer import xpl
from xpl_cli.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize("task", ["lift_cube", "handover_block"])
@pytest.mark.parametrize("control", ["joint", "ee"])
def test_the_expert_solves_a_few_seeds_through_the_server(tmp_path: Path, task: str, control: str) -> None:
    """The privileged expert, served like any other adapter, succeeds."""
    options = ["--env", "mujoco", "--task", task, "--episodes", "2", "--set", f"action_type={control}", "--json"]
    done = xpl("eval", "scripted_expert", *options, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert json.loads(done.stdout)["successes"] == 2


@pytest.mark.slow
@pytest.mark.parametrize("task", ["lift_cube", "handover_block"])
def test_expert_20_of_20_and_demo_policy_0_of_20(tmp_path: Path, task: str) -> None:
    """The tasks are solvable, and not by standing still."""
    for policy, won in (("scripted_expert", 20), ("demo_policy", 0)):
        options = ["--env", "mujoco", "--task", task, "--episodes", "20", "--json"]
        done = xpl("eval", policy, *options, cwd=tmp_path)
        assert done.returncode == ExitCode.CLEAN, done.stderr
        assert json.loads(done.stdout)["successes"] == won


def test_holding_the_pose_does_not_lift_a_cube(tmp_path: Path) -> None:
    """demo_policy fails the task and the report says so."""
    options = ["--env", "mujoco", "--task", "lift_cube", "--episodes", "1", "--json"]
    report = json.loads(xpl("eval", "demo_policy", *options, cwd=tmp_path).stdout)
    assert report["successes"] == 0
    assert report["episodes"][0]["end_reason"] == "max_steps"


def test_a_batch_of_environments_runs_as_many_episodes_as_asked_for(tmp_path: Path) -> None:
    """Three episodes, two at a time, each with its own seed."""
    options = ["--env", "mujoco", "--task", "lift_cube", "--episodes", "3", "--num-envs", "2", "--seed", "5", "--json"]
    report = json.loads(xpl("eval", "scripted_expert", *options, cwd=tmp_path).stdout)
    assert [episode["seed"] for episode in report["episodes"]] == [5, 6, 7]
    assert report["successes"] == 3


def test_the_scripts_of_a_scaffold_run_a_debug_evaluation(tmp_path: Path) -> None:
    """eval.sh with the ten positional arguments of the ecosystem ends with the line that launchers look for."""
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
    ("options", "code", "said"),
    [
        (["--env", "mujoco", "--task", "fold_shirt"], ExitCode.NOT_FOUND, "lift_cube"),
        (["--env", "isaac"], ExitCode.NOT_FOUND, "mujoco, offline"),
        (["--env", "mujoco", "--set", "env_cfg_type=franka"], ExitCode.USAGE, "has no franka"),
        (["--set", "seed"], ExitCode.USAGE, "KEY=VALUE"),
    ],
)
def test_what_cannot_be_evaluated_is_refused_in_one_sentence(
    tmp_path: Path, options: list[str], code: ExitCode, said: str
) -> None:
    """The message lists what there is; no traceback."""
    done = xpl("eval", "demo_policy", *options, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (code, "")
    assert said in done.stderr
    assert "Traceback" not in done.stderr


BREAKS_ONCE = """
    import os, signal
    from pathlib import Path
    import numpy as np

    class Model:
        def __init__(self, config):
            self.config = config
            self.calls = 0

        def reset(self): pass
        def update_obs(self, obs): self.state = obs["state"]
        def update_obs_batch(self, obs_list): self.update_obs(obs_list[-1])

        def get_action(self):
            self.calls += 1
            left = int(Path(self.config["marks"]).read_text())
            if self.calls == 3 and left:
                Path(self.config["marks"]).write_text(str(left - 1))
                os.kill(os.getpid(), signal.SIGKILL)
            keys = ("arm_joint_state", "ee_joint_state")
            return [{key: np.asarray(self.state[key], np.float32) for key in keys}]
"""


@pytest.mark.parametrize(("deaths", "code", "failed"), [(1, ExitCode.CLEAN, 0), (9, ExitCode.NOT_RUN, 2)])
def test_a_trial_that_the_infrastructure_spoils_counts_neither_way(
    write_adapter: Callable[..., Path], tmp_path: Path, deaths: int, code: ExitCode, failed: int
) -> None:
    """It is played again with a new server; what fails for good is reported apart, and never as a failed task."""
    adapter = write_adapter(BREAKS_ONCE)
    deploy = {"env_cfg_type": "franka_single", "marks": str(tmp_path / "marks")}
    (adapter / "deploy.yml").write_text(json.dumps(deploy), encoding="utf-8")
    shutil.copy(ROOT / "policy" / "demo_policy" / "deploy.py", adapter)
    (tmp_path / "marks").write_text(str(deaths), encoding="utf-8")
    done = xpl("eval", str(adapter), "--env", "offline", "--episodes", "2", "--json", cwd=tmp_path)
    assert done.returncode == code, done.stderr
    report = json.loads(done.stdout)
    assert len(report["episodes"]) == 2
    assert report["infrastructure_failures"] == failed
    assert [episode["end_reason"] for episode in report["episodes"]].count("infrastructure") == failed
    assert "SIGKILL" in done.stderr


def test_a_policy_that_does_not_fit_is_refused_before_the_first_step(
    write_adapter: Callable[..., Path], tmp_path: Path
) -> None:
    """The manifest asks for another rate than the environment has."""
    adapter = write_adapter(BREAKS_ONCE, control_frequency=50, inputs={"required": ["state.mobile"]})
    shutil.copy(ROOT / "policy" / "demo_policy" / "deploy.py", adapter)
    done = xpl("eval", str(adapter), "--env", "offline", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (ExitCode.USAGE, "")
    assert "50 Hz" in done.stderr
    assert "state.mobile" in done.stderr
