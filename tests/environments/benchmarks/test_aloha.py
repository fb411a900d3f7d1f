"""envs/aloha with gym-aloha itself: arms move as commanded, episodes replay, its expert solves tasks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.environments.benchmarks import peers
from xpl import get_embodiment
from xpl.kinematics import Chain
from xpl.poses import compose

ALOHA = peers.Benchmark("aloha")

pytestmark = [peers.patient, pytest.mark.slow, ALOHA.needed]


@pytest.fixture(scope="module")
def looked() -> Any:
    """Return observations of the simulator, without images, which a machine may not be able to render."""
    return ALOHA.look("still")["still"]


@pytest.mark.parametrize("arm", ["left", "right"])
def test_joints_that_kinematics_finds_move_the_tool_along_an_axis_of_the_world(looked: Any, arm: str) -> None:
    """By the commanded 4 cm: the right arm faces the left one, and both have the same axes."""
    assert peers.move_along_axes(looked["axes"][arm], 0.04, within=0.005)


def test_closing_closes_and_opening_opens(looked: Any) -> None:
    """Fingers reach 0.97 of what gym-aloha calls open; shut on nothing they stay at 0.1, where an episode begins."""
    for opened, closed in looked["openings"].values():
        assert (opened > 0.95, closed < 0.12) == (True, True)


def test_joints_and_flanges_agree_by_kinematics(looked: Any) -> None:
    """The standard's ViperX matches gym-aloha's; quaternions are [w, x, y, z]."""
    chain, state = Chain.from_embodiment(get_embodiment(ALOHA.robots[0]).data), looked["state"]
    for arm, base in looked["bases"].items():
        flange = compose(base, chain.flange(state[f"{arm}_arm_joint_state"]))
        assert peers.same_pose(flange, state[f"{arm}_ee_pose"], 1e-5, 1e-4)


def test_rewards_are_gym_alohas_own_all_the_way_to_success(looked: Any) -> None:
    """The contact table replaces its physics; random actions earn no success."""
    assert looked["rewards"][-1] == [4, 4]
    assert all(ours == theirs for ours, theirs in looked["rewards"])
    assert {ours for ours, _ in looked["rewards"]} >= {0, 1, 2, 4}
    assert looked["guessed"] == 0


def test_gym_aloha_plays_and_draws_the_same_and_pictures_are_upright() -> None:
    """Joints and pixels bit by bit; the red cube and the other arm are where their projections say."""
    observed = ALOHA.look("seen")["seen"]
    assert observed["different"] == 0
    assert all(peers.is_colored(color, 0) for color in observed["box"].values())
    assert observed["left"] == observed["right"] == [True, False]
    assert observed["angle"] == observed["front_close"] == ["cam_head", "cam_third_view"]


@pytest.mark.parametrize("task", ALOHA.manifest["tasks"])
def test_the_expert_solves_a_task_over_the_wire(task: str) -> None:
    ALOHA.solve("--task", task, "--set", f"env_cfg_type={ALOHA.robots[0]}", "--set", "action_type=joint")


def test_the_environment_passes_its_audit(tmp_path: Path) -> None:
    ALOHA.audit(tmp_path, task="transfer_cube")
