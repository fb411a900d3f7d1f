"""envs/aloha with gym-aloha itself: its arms are moved and looked at, it is played again, its expert solves tasks."""

from __future__ import annotations

import json
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

ENV = build.ROOT / "envs" / "aloha"
MANIFEST = environments.manifest(ENV).data
ROBOT = MANIFEST["embodiments"][0]
PYTHON = build.interpreter("aloha", locks=ENV)

needed = peers.needed("aloha", PYTHON)
pytestmark = peers.patient


def test_every_setting_draws_declared_cameras_and_the_one_of_gym_aloha() -> None:
    """The others cost a policy time that does not look."""
    assert set(MANIFEST["drawn"]) == set(MANIFEST["settings"])
    for cameras in MANIFEST["drawn"].values():
        assert cameras["cam_head"] == "top"
        assert set(cameras) <= set(MANIFEST["cameras"])


@pytest.fixture(scope="module")
def looked() -> dict[str, Any]:
    """Return what a look at the simulator found; without pictures, which a machine may not draw."""
    return peers.look("aloha", PYTHON, ROBOT)


@needed
@pytest.mark.slow
@pytest.mark.parametrize("arm", ["left", "right"])
@pytest.mark.parametrize("way", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_joints_that_kinematics_finds_move_the_tool_along_an_axis_of_the_world(
    looked: dict[str, Any], arm: str, way: str
) -> None:
    """By the 4 cm that were asked for: the right arm faces the left one, and both have the same axes."""
    wanted = (0.04 if way[0] == "+" else -0.04) * np.eye(3)["xyz".index(way[1])]
    assert np.abs(np.array(looked["axes"][arm][way]) - wanted).max() < 0.005


@needed
@pytest.mark.slow
def test_closing_closes_and_opening_opens(looked: dict[str, Any]) -> None:
    """Fingers reach 0.97 of what gym-aloha calls open; shut on nothing they stay at 0.1, where an episode begins."""
    for opened, closed in looked["openings"].values():
        assert (opened > 0.95, closed < 0.12) == (True, True)


@needed
@pytest.mark.slow
def test_joints_and_flanges_agree_by_kinematics(looked: dict[str, Any]) -> None:
    """The standard's ViperX stands in gym-aloha; quaternions are [w, x, y, z]."""
    chain, state = Chain.from_embodiment(get_embodiment(ROBOT).data), looked["state"]
    for arm, base in looked["bases"].items():
        flange = compose(base, chain.flange(state[f"{arm}_arm_joint_state"]))
        assert np.abs(flange[:3] - state[f"{arm}_ee_pose"][:3]).max() < 1e-5
        assert rotation.angle_between(flange[3:], state[f"{arm}_ee_pose"][3:]) < 1e-4


@needed
@pytest.mark.slow
def test_random_actions_solve_nothing(looked: dict[str, Any]) -> None:
    """Two episodes about the first pose."""
    assert looked["guessed"] == 0


@needed
@pytest.mark.slow
def test_rewards_are_gym_alohas_own_all_the_way_to_success(looked: dict[str, Any]) -> None:
    """It is told of contacts by something faster than its physics."""
    assert looked["rewards"][-1] == [4, 4]
    assert all(ours == theirs for ours, theirs in looked["rewards"])
    assert {ours for ours, _ in looked["rewards"]} >= {0, 1, 2, 4}


@needed
@pytest.mark.slow
def test_gym_aloha_plays_and_draws_the_same_and_pictures_are_upright() -> None:
    """Joints and pixels bit by bit; the red cube and the other arm are where their projections say."""
    seen = peers.look("aloha", PYTHON, ROBOT, "pictures")["seen"]
    assert seen["different"] == 0
    for red, green, blue in seen["box"].values():
        assert red > 3 * max(green, blue, 1)
    assert seen["left"] == seen["right"] == [True, False]
    assert seen["angle"] == seen["front_close"] == ["cam_head", "cam_third_view"]


@needed
@pytest.mark.slow
@pytest.mark.parametrize("task", MANIFEST["tasks"])
def test_the_expert_solves_a_task_over_the_wire(task: str) -> None:
    """Served, asked, its answer sent as it is to gym-aloha."""
    place = ("--env", str(ENV), "--eval-env", f"venv:{peers.folder(PYTHON)}", "--task", task, "--episodes", "2")
    expert = ("--set", f"env_cfg_type={ROBOT}", "--set", "action_type=joint")
    policy = str(build.ROOT / "policy" / "benchmark_expert")
    done = xpl("eval", policy, *place, *expert, "--json", cwd=build.ROOT)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert json.loads(done.stdout)["success_rate"] == 1.0


@needed
@pytest.mark.slow
def test_the_environment_passes_its_audit(tmp_path: Path) -> None:
    """Every rule for environments, with one task and without pictures."""
    options = ("--python", str(PYTHON), "--set", "task=transfer_cube", "--set", "cameras=false", "--no-cache", "--json")
    done = xpl("audit", str(ENV), *options, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stdout
