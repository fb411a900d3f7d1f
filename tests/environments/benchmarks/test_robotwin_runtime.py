"""envs/robotwin with RoboTwin's own runtime and a robot that stands in: tasks begin, arms are moved and looked at.

Nothing here is a number of RoboTwin: the robot is another one.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.interop import build
from tests.environments.benchmarks import peers
from tests.support.peer import xpl
from xpl import get_embodiment, rotation
from xpl.kinematics import Chain
from xpl.poses import compose
from xpl_cli.basics.errors import ExitCode
from xpl_cli.packages import environments

pytestmark = [pytest.mark.slow, peers.patient]

ENV = build.ROOT / "envs" / "robotwin"
MANIFEST = environments.manifest(ENV).data
PYTHON = build.interpreter("robotwin", locks=ENV)
ROBOT = get_embodiment("aloha_agilex")
SETTING = "stand_in_robot"
SIDES = ("left", "right")
STEPS = 3


def _look(*parts: str) -> dict[str, Any]:
    try:
        return peers.look("robotwin", PYTHON, *parts)
    except AssertionError as error:
        if "RendererMissingError" in str(error):
            pytest.skip("not run: there is no Vulkan device; envs/maniskill/mesa.sh gets a driver")
        raise


@pytest.fixture(scope="module", autouse=True)
def _installed() -> None:
    if PYTHON is None:
        pytest.skip("not run: robotwin is not installed from envs/robotwin/robotwin.lock.txt; `./dev peers` does so")


@pytest.fixture(scope="module")
def joints() -> dict[str, Any]:
    """Return what was seen of arms that are told angles."""
    found: dict[str, Any] = _look("joints")["joints"]
    return found


@pytest.fixture(scope="module")
def played() -> dict[str, Any]:
    """Return what came of episodes that were won, lost, skipped and refused."""
    return _look("won", "loop", "tasks")


def test_pictures_are_upright_and_robotwins_own(joints: dict[str, Any]) -> None:
    """Blocks are where their projection says, in RGB; what is higher is further up, and +x is to the right."""
    assert joints["observed"] == {name: [240, 320, 3] for name in MANIFEST["cameras"]}
    for place, name in enumerate(("red", "green")):
        color = joints["seen"][name]
        assert color[place] > 3 * max(color[:place] + color[place + 1 :])
    (on, above), (left, right) = joints["seen"]["rows"], joints["seen"]["columns"]
    assert (above < on - 10, left < right - 50, joints["same"]) == (True, True, True)


def test_joints_and_poses_agree_by_kinematics(joints: dict[str, Any]) -> None:
    """Quaternions are [w, x, y, z], poses are in RoboTwin's world, ee_pose is the flange and 0.12 m behind the tool."""
    chain, found = Chain.from_embodiment(ROBOT.data), joints["kinematics"]
    for place, side in enumerate(SIDES):
        flange = compose(found["bases"][place], chain.flange(found["measured"][6 * place :][:6]))
        for name, ahead in (("ee_pose", 0.0), ("tcp_pose", 0.12)):
            wanted = compose(flange, [ahead, 0, 0, 1, 0, 0, 0])
            seen = found["poses"][f"{side}_{name}"]
            assert np.abs(np.subtract(seen, wanted)[:3]).max() < 1e-4
            assert rotation.angle_between(seen[3:], wanted[3:]) < 1e-3


def test_a_command_moves_the_joint_that_it_names_and_no_other(joints: dict[str, Any]) -> None:
    """By the angle that was asked for: at once what is told, and what is measured a little later."""
    for move in joints["moved"]:
        wanted = 0.15 * np.eye(12)[move["place"]]
        assert np.abs(np.subtract(move["told"], wanted)).max() < 1e-6
        assert np.abs(np.subtract(move["measured"], wanted)).max() < 0.01


def test_the_observed_angle_is_the_drives_target(joints: dict[str, Any]) -> None:
    """Which RoboTwin's policies were trained on; what is measured comes near it."""
    assert joints["lag"]["told"] == 0
    assert 0 < joints["lag"]["measured_later"] < 0.01


def test_a_gripper_is_open_at_one_and_closed_at_zero(joints: dict[str, Any]) -> None:
    """Both fingers of both hands; what is told is what was commanded."""
    closed, opened = joints["fingers"]
    assert (max(closed["measured"]) < 0.002, closed["told"]) == (True, [0, 0])
    assert (min(opened["measured"]) > 0.04, opened["told"]) == (True, [1, 1])


@pytest.fixture(scope="module")
def poses() -> dict[str, Any]:
    """Return what was seen of arms that are told poses."""
    found: dict[str, Any] = _look("poses")["poses"]
    return found


def test_ways_to_a_pose_are_the_same_again(poses: dict[str, Any]) -> None:
    """Though mplib searches at random."""
    first, again = poses["again"]
    assert first == again


def test_a_pose_moves_the_tool_along_an_axis_of_the_world(poses: dict[str, Any]) -> None:
    """By the 4 cm that were asked for, of the one arm that was sent; where no way leads, that is said."""
    for axis in poses["axes"]:
        left, right = axis["moved"]
        assert np.abs(np.subtract(left, axis["wanted"])).max() < 0.005
        assert np.abs(right).max() < 0.003
        assert "unreached" not in axis["corrections"].get("left_", {})
    assert poses["unreached"]["right_"]["unreached"] > 0.01


def test_success_is_robotwins_own_check(played: dict[str, Any]) -> None:
    """Blocks that are placed by hand win, with the next step; before, nothing is won."""
    assert played["won"]["before"] == [False, False]
    won = played["won"]["won"]
    assert (won["success"], won["score"], won["end_reason"], won["steps"]) == (True, 1.0, "success", 2)


def test_the_limit_of_steps_ends_an_episode(played: dict[str, Any]) -> None:
    """RoboTwin's own is the same, and is that of the environment where another one is asked for."""
    lost = played["won"]["limit"]
    assert (lost["success"], lost["end_reason"], lost["steps"]) == (False, "max_steps", STEPS)


def test_robotwins_loop_skips_an_unstable_seed_and_ends_with_a_plain_rate(played: dict[str, Any]) -> None:
    """Seeds from 100000 on; the expert of another robot solves none, and is asked for none."""
    told = played["loop"]
    assert told["skipped"] == {"100000": "unstable"}
    ((episode,), rate) = told["episodes"], told["rate"]
    assert (episode["seed"], episode["success"], episode["steps"], episode["error"]) == (100001, True, 2, None)
    assert (type(rate), rate) == (float, 1.0)
    assert told["names"][:2] == ["prepare_case", "reset"]
    assert told["names"][-1] == "trial_end"


def test_each_task_begins_by_its_seed_alone(played: dict[str, Any]) -> None:
    """Things lie elsewhere for another seed, and in the same places again; so does the wording."""
    found = dict(played["tasks"])
    assert "only RoboTwin's assets have" in found.pop("refused")
    assert list(found) == MANIFEST["stand_ins"][SETTING]["tasks"]
    for begun in found.values():
        first, other, again = begun
        assert first["things"] != other["things"]
        assert (first["things"], first["instruction"]) == (again["things"], again["instruction"])
        assert "{" not in first["instruction"]
    assert "red block" in found["stack_blocks_two"][0]["instruction"]
    assert len({begun[0]["instruction"] for begun in found.values()}) == len(found)


def test_the_environment_passes_its_audit(tmp_path: Path) -> None:
    """Every rule for environments, with one task, by angles and without pictures."""
    options = ("--set", f"setting={SETTING}", "--set", "task=stack_blocks_two", "--set", "action_type=joint")
    more = ("--python", str(PYTHON), "--set", "cameras=false", "--no-cache", "--json")
    done = xpl("audit", str(ENV), *options, *more, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, json.loads(done.stdout)


def test_an_episode_over_the_wire_is_recorded_and_never_taken_for_robotwins(tmp_path: Path) -> None:
    """Served, played and recorded; the report says what stood in, and no leaderboard takes it."""
    env = tmp_path / "envs" / "robotwin"
    shutil.copytree(ENV, env, ignore=shutil.ignore_patterns(".venv", "__pycache__"))
    text = (env / "env.yml").read_text(encoding="utf-8")
    (env / "env.yml").write_text(
        text.replace("stack_blocks_two: { max_steps: 800", f"stack_blocks_two: {{ max_steps: {STEPS}")
    )
    policy, run = str(build.ROOT / "policy" / "demo_policy"), str(tmp_path / "run")
    place = ("--env", str(env), "--eval-env", f"venv:{peers.folder(PYTHON)}", "--setting", SETTING)
    what = ("--task", "stack_blocks_two", "--set", "env_cfg_type=aloha_agilex", "--out", run, "--json")
    done = xpl("eval", policy, *place, *what, cwd=build.ROOT)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    found = json.loads(done.stdout)
    assert (found["overall"]["judged"], found["overall"]["mean_steps"]) == (1, STEPS)
    assert "stands in for a part of robotwin" in found["notes"][0]
    ranked = xpl("leaderboard", run, "--robotwin", str(tmp_path / "out"), cwd=build.ROOT)
    assert ranked.returncode == ExitCode.NOT_RUN
    assert "none of robotwin's numbers" in ranked.stderr
    assert not (tmp_path / "out").exists()
