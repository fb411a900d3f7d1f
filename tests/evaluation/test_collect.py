"""`xpl record`: the requested episodes are saved, on seeds of their own, and a kill costs one episode at most."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.checkout import ROOT
from tests.support.commands import xpl
from tests.support.peer import wait_until
from tests.support.recordings.runs import episode, planned
from xpl import trajectory
from xpl_cli.basics.errors import UserError
from xpl_cli.environments import check
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.records.model import PlannedCell
from xpl_cli.evaluation.rollout import config, trajectory_recorder
from xpl_cli.evaluation.runs import collect, plan
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from pathlib import Path

PLAIN = ("offline", "--policy", "demo_policy", "--images", "16x16", "--horizon", "4")


def _json(*arguments: str | Path) -> dict[str, Any]:
    ended = xpl(*arguments, "--json", limit_s=240)
    assert ended.code == 0, ended.stderr
    answer: dict[str, Any] = json.loads(ended.stdout)
    return answer


def test_a_set_is_recorded_and_is_valid(tmp_path: Path) -> None:
    demos = tmp_path / "demos"
    answer = _json("record", *PLAIN, "--episodes", "1", "--out", demos)
    assert (answer["episodes"], answer["steps"], answer["tasks"][0]["discarded"]) == (1, 5, 0)
    refused = xpl("record", *PLAIN, "--episodes", "2", "--out", demos)
    assert (refused.code, "--resume" in refused.stderr) == (2, True)
    assert xpl("spec", "validate", demos / "episode_0000000.hdf5").code == 0
    episode = trajectory.open_folder(demos)[0]
    assert episode.image("cam_head", 4).shape == (16, 16, 3)
    assert (episode.episode["policy"], episode.episode["seed"]) == ("demo_policy", 0)


def test_practice_leaves_the_evaluation_seeds_alone() -> None:
    folder = environments.find("mujoco")
    tests = check.seeds(folder, "lift_cube", "clean")
    plan_request = plan.PlanRequest(episodes=500, first=min(tests), is_practice=True)
    seeds, frozen = plan._seeds(folder, "lift_cube", "clean", plan_request)
    assert (len(seeds), len(set(seeds)), frozen) == (500, 500, False)
    assert not set(seeds) & set(tests)


@pytest.mark.parametrize(
    ("outcomes", "ended"),
    [([True] * 3, True), ([True, False, True], False), ([False] * 19, False), ([False] * 20, True)],
)
def test_a_task_ends_when_it_has_enough_or_never_will(outcomes: list[bool | None], ended: bool) -> None:
    """Twenty attempts without a saved one are not bad luck."""
    assert collect._stop_rule(3)(outcomes) is ended


def test_a_set_is_the_first_of_the_plan_and_reports_discarded_episodes(tmp_path: Path) -> None:
    """Further episodes, as with several workers, are moved aside and do not count."""
    failures = [None, "task", "infrastructure", None, None]
    lines = {
        index: episode(index=index, task="lift", steps=7, success=not failure, failure=failure)
        for index, failure in enumerate(failures)
    }
    for index, failure in enumerate(failures):
        if failure is None:
            (tmp_path / trajectory_recorder.file_name(index)).write_bytes(b"12345")
    line = planned(cells=[PlannedCell("lift", "clean", None, range(5), frozen=False)])
    request = collect.RecordRequest("E", config.RecordingConfig(str(tmp_path), config.SUCCESS), episodes=2)
    demonstrations = collect._summary(records.Run(tmp_path / "run", line, finals=lines), request, "P", 1.0)
    assert demonstrations.tasks == [
        collect.TaskDemonstrations(
            "lift", "clean", 2, requested=2, tried=4, discarded=1, infrastructure_errors=1, steps=14
        )
    ]
    assert (demonstrations.bytes, [path.name for path in tmp_path.glob("*.hdf5")].count("episode_0000004.hdf5")) == (
        10,
        0,
    )
    assert "1 of 4 tries discarded, 1 infrastructure errors" in demonstrations.text()
    collect._restore_surplus(tmp_path)
    assert (tmp_path / "episode_0000004.hdf5").is_file()
    (tmp_path / "episode_0000000.hdf5").unlink()
    with pytest.raises(UserError, match="is not there any more"):
        collect._summary(records.Run(tmp_path / "run", line, finals=lines), request, "P", 1.0)


def test_a_missing_policy_is_reported_in_one_sentence(tmp_path: Path) -> None:
    ended = xpl("record", "offline", "--out", tmp_path / "demos")
    assert ended.code == 3
    assert "offline has no scripted expert" in ended.stderr
    assert "the leader arm of teleoperation" in ended.stderr
    assert xpl("record", "offline", "--out", tmp_path / "demos", "--images", "big").code == 2
    assert not (tmp_path / "demos").exists()


@pytest.mark.slow
def test_an_evaluation_keeps_its_episodes_on_request(tmp_path: Path) -> None:
    """The trajectories hold the policy's observations and agree with the record beside them."""
    demos, run = tmp_path / "demos", tmp_path / "run"
    command = ("eval", "demo_policy", "--env", "offline", "--horizon", "4", "--record", demos, "--out", run)
    _json(*command)
    episode = trajectory.open_folder(demos)[0]
    final = records.read(run).finals[0]
    assert [len(episode), episode.episode["steps"], episode.episode["seed"]] == [5, final.steps, final.seed]
    again = xpl("eval", "demo_policy", "--env", "offline", "--record", demos)
    assert (again.code, "already" in again.stderr) == (2, True)
    assert xpl("eval", "demo_policy", "--env", "offline", "--keep", "all").code == 2


@pytest.mark.slow
def test_the_expert_of_a_simulation_is_recorded_through_a_kill(tmp_path: Path) -> None:
    """A killed command continues where it was; two workers save the same episodes as one."""
    demos = tmp_path / "demos"
    command = [sys.executable, "-m", "xpl_cli", "record", "mujoco", "--task", "lift_cube", "--images", "32x32"]
    command += ["--episodes", "4", "--out", str(demos)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    running = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True)
    wait_until(lambda: next(demos.glob("*.hdf5"), None) is not None, "the first episode")
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    done = subprocess.run([*command, "--resume", "--workers", "2"], env=environment, check=False, capture_output=True)
    assert done.returncode == 0, done.stderr
    episodes = trajectory.open_folder(demos)
    assert len(episodes) == 4
    assert all(one.episode["success"] for one in episodes)
    finals = records.read(demos / "run").finals
    assert [one.episode["seed"] for one in episodes] == [line.seed for line in finals.values() if line.success][:4]
