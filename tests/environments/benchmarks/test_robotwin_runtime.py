"""envs/robotwin with RoboTwin's own runtime and a mock robot: tasks begin, arms move as commanded.

Nothing here is a result of RoboTwin: the robot is another one.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.interop import build
from tests.environments.benchmarks import peers
from tests.support.peer import xpl
from xpl import get_embodiment
from xpl.kinematics import Chain
from xpl.poses import compose
from xpl_cli.basics.errors import ExitCode

ROBOTWIN = peers.Benchmark("robotwin")
ROBOT = get_embodiment("aloha_agilex")
SETTING = "stand_in_robot"
STEPS = 3

pytestmark = [pytest.mark.slow, peers.patient, ROBOTWIN.needed]


@pytest.fixture(scope="module")
def looked() -> Any:
    """Return observations of arms with joint and pose commands, and of episodes: won, lost, skipped and refused."""
    try:
        return ROBOTWIN.look("joints", "poses", "won", "loop", "tasks")
    except AssertionError as error:
        if "RendererMissingError" in str(error):
            pytest.skip(peers.NO_VULKAN)
        raise


def test_pictures_are_upright_and_robotwins_own(looked: Any) -> None:
    """Blocks are where their projection says, in RGB; what is higher is further up, and +x is to the right."""
    assert looked["joints"]["observed"] == {name: [240, 320, 3] for name in ROBOTWIN.manifest["cameras"]}
    for index, name in enumerate(("red", "green")):
        color = looked["joints"]["seen"][name]
        assert peers.is_colored(color, index)
    (on, above), (left, right) = looked["joints"]["seen"]["rows"], looked["joints"]["seen"]["columns"]
    assert (above < on - 10, left < right - 50, looked["joints"]["same"]) == (True, True, True)


def test_joints_and_poses_agree_by_kinematics(looked: Any) -> None:
    """Quaternions are [w, x, y, z], poses are in RoboTwin's world, ee_pose is the flange and 0.12 m behind the tool."""
    chain, poses = Chain.from_embodiment(ROBOT.data), looked["joints"]["kinematics"]
    for index, side in enumerate(("left", "right")):
        flange = compose(poses["bases"][index], chain.flange(poses["measured"][6 * index :][:6]))
        for name, ahead in (("ee_pose", 0.0), ("tcp_pose", 0.12)):
            expected = compose(flange, [ahead, 0, 0, 1, 0, 0, 0])
            assert peers.same_pose(poses["poses"][f"{side}_{name}"], expected, metres=1e-4)


def test_a_command_moves_the_joint_that_it_names_and_no_other(looked: Any) -> None:
    """By the commanded angle: the command at once, the measurement a little later."""
    for move in looked["joints"]["moved"]:
        expected = 0.15 * np.eye(12)[move["place"]]
        assert np.abs(np.subtract(move["told"], expected)).max() < 1e-6
        assert np.abs(np.subtract(move["measured"], expected)).max() < 0.01


def test_the_observed_angle_is_the_drives_target(looked: Any) -> None:
    """Which RoboTwin's policies were trained on; what is measured comes near it."""
    assert looked["joints"]["lag"]["told"] == 0
    assert 0 < looked["joints"]["lag"]["measured_later"] < 0.01


def test_a_gripper_is_open_at_one_and_closed_at_zero(looked: Any) -> None:
    """Both fingers of both hands; the state is the commanded value."""
    closed, opened = looked["joints"]["fingers"]
    assert (max(closed["measured"]) < 0.002, closed["told"]) == (True, [0, 0])
    assert (min(opened["measured"]) > 0.04, opened["told"]) == (True, [1, 1])


def test_ways_to_a_pose_are_the_same_again(looked: Any) -> None:
    """Though mplib searches at random."""
    first, again = looked["poses"]["again"]
    assert first == again


def test_a_pose_moves_the_tool_along_an_axis_of_the_world(looked: Any) -> None:
    """By the commanded 4 cm, of the commanded arm; an unreachable pose is reported."""
    for axis in looked["poses"]["axes"]:
        left, right = axis["moved"]
        assert np.abs(np.subtract(left, axis["wanted"])).max() < 0.005
        assert np.abs(right).max() < 0.003
        assert "unreached" not in axis["corrections"].get("left_", {})
    assert looked["poses"]["unreached"]["right_"]["unreached"] > 0.01


def test_success_is_robotwins_own_check(looked: Any) -> None:
    """Blocks that are placed by hand succeed, with the next step, and not before."""
    assert looked["won"]["before"] == [False, False]
    won = looked["won"]["won"]
    assert (won["success"], won["score"], won["end_reason"], won["steps"]) == (True, 1.0, "success", 2)


def test_the_limit_of_steps_ends_an_episode(looked: Any) -> None:
    lost = looked["won"]["limit"]
    assert (lost["success"], lost["end_reason"], lost["steps"]) == (False, "max_steps", STEPS)


def test_robotwins_loop_skips_an_unstable_seed_and_ends_with_a_plain_rate(looked: Any) -> None:
    """Seeds from 100000 on; the expert of another robot solves none, and is not required."""
    result = looked["loop"]
    assert result["skipped"] == {"100000": "unstable"}
    ((episode,), rate) = result["episodes"], result["rate"]
    assert (episode["seed"], episode["success"], episode["steps"], episode["error"]) == (100001, True, 2, None)
    assert (type(rate), rate) == (float, 1.0)
    assert result["names"][:2] == ["prepare_case", "reset"]
    assert result["names"][-1] == "trial_end"


def test_each_task_begins_by_its_seed_alone(looked: Any) -> None:
    """Objects are elsewhere for another seed, and in the same places for the same one; so is the wording."""
    results = dict(looked["tasks"])
    assert "only RoboTwin's assets have" in results.pop("refused")
    assert list(results) == ROBOTWIN.manifest["stand_ins"][SETTING]["tasks"]
    for begun in results.values():
        first, other, again = begun
        assert first["things"] != other["things"]
        assert (first["things"], first["instruction"]) == (again["things"], again["instruction"])
        assert "{" not in first["instruction"]
    assert "red block" in results["stack_blocks_two"][0]["instruction"]
    assert len({begun[0]["instruction"] for begun in results.values()}) == len(results)


def test_the_environment_passes_its_audit(tmp_path: Path) -> None:
    ROBOTWIN.audit(tmp_path, setting=SETTING, task="stack_blocks_two", action_type="joint")


def test_an_episode_over_the_wire_is_recorded_and_never_taken_for_robotwins(tmp_path: Path) -> None:
    """Served, run and recorded; the report names the mock, and no leaderboard accepts it."""
    env = tmp_path / "envs" / "robotwin"
    shutil.copytree(ROBOTWIN.env, env, ignore=shutil.ignore_patterns(".venv", "__pycache__"))
    text = (env / "env.yml").read_text(encoding="utf-8")
    (env / "env.yml").write_text(
        text.replace("stack_blocks_two: { max_steps: 800", f"stack_blocks_two: {{ max_steps: {STEPS}")
    )
    run = str(tmp_path / "run")
    chosen = ("--env", str(env), "--setting", SETTING, "--task", "stack_blocks_two", "--out", run)
    ended = ROBOTWIN.play("demo_policy", *chosen, "--set", "env_cfg_type=aloha_agilex")
    assert (ended["overall"]["judged"], ended["overall"]["mean_steps"]) == (1, STEPS)
    assert "replaces a part of robotwin by a mock" in ended["notes"][0]
    ranked = xpl("leaderboard", run, "--robotwin", str(tmp_path / "out"), cwd=build.ROOT)
    assert ranked.returncode == ExitCode.NOT_RUN
    assert "no results of robotwin" in ranked.stderr
    assert not (tmp_path / "out").exists()
