"""envs/robosuite with robosuite itself: its arms are moved and looked at, every task begins, it is played again."""

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
from xpl_cli.basics.errors import ExitCode
from xpl_cli.packages import environments

ENV = build.ROOT / "envs" / "robosuite"
MANIFEST = environments.manifest(ENV).data
PYTHON = build.interpreter("robosuite", locks=ENV)
ROBOTS = MANIFEST["embodiments"]

needed = peers.needed("robosuite", PYTHON)
pytestmark = peers.patient


def test_every_task_is_offered_with_one_arm_or_with_two_and_stands_in_that_split() -> None:
    """And each number of arms has a head camera and one at each hand."""
    for name, arms in (("single_arm", 1), ("two_arm", 2)):
        assert MANIFEST["splits"][name] == [
            task for task, facts in MANIFEST["tasks"].items() if facts["arms"] == [arms]
        ]
        assert sum(arms in facts["arms"] for facts in MANIFEST["cameras"].values()) == 1 + arms


@pytest.fixture(scope="module")
def looked() -> dict[str, Any]:
    """Return what a look at the simulator found, without pictures."""
    return peers.look("robosuite", PYTHON, *ROBOTS, "moved")


@needed
@pytest.mark.slow
@pytest.mark.parametrize("setting", ["clean", "absolute"])
@pytest.mark.parametrize("way", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_a_command_along_an_axis_moves_the_tool_along_it(looked: dict[str, Any], setting: str, way: str) -> None:
    """By the 3 cm that were asked for."""
    wanted = (0.03 if way[0] == "+" else -0.03) * np.eye(3)["xyz".index(way[1])]
    assert np.abs(np.array(looked[setting]["axes"][way]) - wanted).max() < 0.003


@needed
@pytest.mark.slow
@pytest.mark.parametrize("setting", ["clean", "absolute"])
def test_a_command_turns_the_tool_about_an_axis_of_the_world(looked: dict[str, Any], setting: str) -> None:
    """By the 0.3 rad that were asked for."""
    assert np.abs(np.array(looked[setting]["turns"]) - 0.3 * np.eye(3)).max() < 0.03


@needed
@pytest.mark.slow
def test_each_of_two_arms_moves_along_the_axes_of_the_world_and_the_other_stays(looked: dict[str, Any]) -> None:
    """Their bases are turned by 90 degrees, to the left and to the right; the left arm stands at +y."""
    left, right = looked["two"].pop("sides")
    assert left > right
    for command, moved in looked["two"].items():
        arm, way = command.split()
        other = "left" if arm == "right" else "right"
        assert np.abs(np.array(moved[arm]) - 0.03 * np.eye(3)["xyz".index(way)]).max() < 0.003, command
        assert np.abs(moved[other]).max() < 0.003, command


@needed
@pytest.mark.slow
def test_closing_closes_and_opening_opens(looked: dict[str, Any]) -> None:
    """The standard's gripper is 0 when the fingers touch; robosuite's action is +1 then."""
    closed, opened = looked["openings"]
    assert (closed < 0.05, opened > 0.95) == (True, True)


@needed
@pytest.mark.slow
def test_joints_and_flange_agree_by_kinematics(looked: dict[str, Any]) -> None:
    """Quaternions are [w, x, y, z]; robosuite's own, of the hand, are [x, y, z, w]."""
    state, (place, turn) = looked["state"], (np.array(part) for part in looked["base"])
    flange = Chain.from_embodiment(get_embodiment(ROBOTS[0]).data).flange(state["arm_joint_state"])
    assert np.abs(place + rotation.rotate(turn, flange[:3]) - state["ee_pose"][:3]).max() < 1e-3
    assert rotation.angle_between(rotation.multiply(turn, flange[3:]), state["ee_pose"][3:]) < 1e-3
    x, y, z, w = looked["theirs"]
    assert rotation.angle_between([w, x, y, z], state["tcp_pose"][3:]) < 1e-3


@needed
@pytest.mark.slow
def test_changes_that_a_policy_adds_up_arrive_as_it_said_them(looked: dict[str, Any]) -> None:
    """In the setting `delta`: 25 mm are half of what an action moves, by robosuite's own controller's range."""
    assert looked["range"] == [0.05] * 3 + [0.5] * 3
    assert np.abs(np.array(looked["deltas"]) - [0.5, -0.5, 0.25, 0, 0, 0, 0.5]).max() < 1e-5


@needed
@pytest.mark.slow
def test_what_was_played_here_is_the_same_in_robosuite_itself_bit_by_bit(looked: dict[str, Any]) -> None:
    """Made as its own examples do; and random actions solve nothing."""
    assert looked["replayed"] == {"steps": 16, "different": 0}
    assert looked["guessed"] == 0


@needed
@pytest.mark.slow
def test_every_task_begins_alike_with_a_seed_and_otherwise_with_another() -> None:
    """All 19, whatever was played before; two steps go well."""
    found = peers.look("robosuite", PYTHON, *ROBOTS, "every", *MANIFEST["tasks"])
    assert {task: [True, False, 2] for task in MANIFEST["tasks"]} == found


@needed
@pytest.mark.slow
def test_pictures_are_upright() -> None:
    """The cube is in the pixel where its projection says, and not where it would be upside down."""
    seen = peers.look("robosuite", PYTHON, *ROBOTS, "pictures")
    assert seen == {"cam_head": [True, False], "cam_wrist": [True, False]}


@needed
@pytest.mark.slow
@pytest.mark.parametrize(("task", "robot"), [("Lift", ROBOTS[0]), ("TwoArmLift", ROBOTS[1])])
def test_the_environment_passes_its_audit(task: str, robot: str, tmp_path: Path) -> None:
    """Every rule for environments, without pictures."""
    chosen = ("--set", f"task={task}", "--set", f"embodiment={robot}", "--set", "cameras=false")
    done = xpl("audit", str(ENV), "--python", str(PYTHON), *chosen, "--no-cache", "--json", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, json.loads(done.stdout)
