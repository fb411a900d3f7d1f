"""`xpl eval`: real servers and environments, thin scripts, the line that launchers wait for."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from tests.peer import xpl
from xpl_cli.errors import ExitCode

if TYPE_CHECKING:
    from pathlib import Path


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
