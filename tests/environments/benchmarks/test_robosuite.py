"""envs/robosuite with robosuite itself: its arms move as commanded, every task begins, episodes replay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.environments.benchmarks import peers
from xpl import get_embodiment, rotation
from xpl.kinematics import Chain
from xpl.poses import compose

ROBOSUITE = peers.Benchmark("robosuite")
ONE, TWO = ROBOSUITE.robots

pytestmark = peers.patient


def test_every_task_is_offered_with_one_arm_or_with_two_and_stands_in_that_split() -> None:
    """And each number of arms has a head camera and one at each hand."""
    for name, arms in (("single_arm", 1), ("two_arm", 2)):
        tasks = [task for task, facts in ROBOSUITE.manifest["tasks"].items() if facts["arms"] == [arms]]
        assert ROBOSUITE.manifest["splits"][name] == tasks
        assert sum(arms in facts["arms"] for facts in ROBOSUITE.manifest["cameras"].values()) == 1 + arms


@pytest.fixture(scope="module")
def looked() -> Any:
    """Return observations of the simulator, without images."""
    return ROBOSUITE.look("clean", "absolute", "still", "two", "deltas", "every")


@ROBOSUITE.needed
@pytest.mark.slow
@pytest.mark.parametrize("setting", ["clean", "absolute"])
def test_a_command_moves_and_turns_the_tool_in_the_world(looked: Any, setting: str) -> None:
    assert peers.move_along_axes(looked[setting]["axes"], 0.03, within=0.003)
    assert np.abs(np.array(looked[setting]["turns"]) - 0.3 * np.eye(3)).max() < 0.03


@ROBOSUITE.needed
@pytest.mark.slow
def test_each_of_two_arms_moves_along_the_axes_of_the_world_and_the_other_stays(looked: Any) -> None:
    """Their bases are turned by 90 degrees, to the left and to the right; the left arm stands at +y."""
    left, right = looked["two"].pop("sides")
    assert left > right
    for command, moved in looked["two"].items():
        arm, way = command.split()
        other = "left" if arm == "right" else "right"
        assert np.abs(np.array(moved[arm]) - 0.03 * np.eye(3)["xyz".index(way)]).max() < 0.003, command
        assert np.abs(moved[other]).max() < 0.003, command


@ROBOSUITE.needed
@pytest.mark.slow
def test_closing_closes_and_opening_opens(looked: Any) -> None:
    """The standard's gripper is 0 when the fingers touch; robosuite's action is +1 then."""
    closed, opened = looked["still"]["openings"]
    assert (closed < 0.05, opened > 0.95) == (True, True)


@ROBOSUITE.needed
@pytest.mark.slow
def test_joints_and_flange_agree_by_kinematics(looked: Any) -> None:
    """Quaternions are [w, x, y, z]; robosuite's own, of the hand, are [x, y, z, w]."""
    state = looked["still"]["state"]
    flange = Chain.from_embodiment(get_embodiment(ONE).data).flange(state["arm_joint_state"])
    assert peers.same_pose(compose(np.concatenate(looked["still"]["base"]), flange), state["ee_pose"])
    x, y, z, w = looked["still"]["theirs"]
    assert rotation.angle_between([w, x, y, z], state["tcp_pose"][3:]) < 1e-3


@ROBOSUITE.needed
@pytest.mark.slow
def test_changes_that_a_policy_adds_up_arrive_as_it_said_them(looked: Any) -> None:
    """In the setting `delta`: 25 mm are half of what an action moves, by robosuite's own controller's range."""
    assert looked["still"]["range"] == [0.05] * 3 + [0.5] * 3
    assert np.abs(np.array(looked["deltas"]) - [0.5, -0.5, 0.25, 0, 0, 0, 0.5]).max() < 1e-5


@ROBOSUITE.needed
@pytest.mark.slow
def test_what_was_played_here_is_the_same_in_robosuite_itself_bit_by_bit(looked: Any) -> None:
    """Made as its own examples do; and random actions solve nothing."""
    assert looked["still"]["replayed"] == {"steps": 16, "different": 0}
    assert looked["still"]["guessed"] == 0


@ROBOSUITE.needed
@pytest.mark.slow
def test_every_task_begins_alike_with_a_seed_and_otherwise_with_another(looked: Any) -> None:
    assert looked["every"] == {task: [True, False, 2] for task in ROBOSUITE.manifest["tasks"]}


@ROBOSUITE.needed
@pytest.mark.slow
def test_pictures_are_upright() -> None:
    """The cube is in the pixel where its projection says, and not where it would be upside down."""
    assert ROBOSUITE.look("seen")["seen"] == {"cam_head": [True, False], "cam_wrist": [True, False]}


@ROBOSUITE.needed
@pytest.mark.slow
@pytest.mark.parametrize(("task", "robot"), [("Lift", ONE), ("TwoArmLift", TWO)])
def test_the_environment_passes_its_audit(task: str, robot: str, tmp_path: Path) -> None:
    ROBOSUITE.audit(tmp_path, task=task, embodiment=robot)
