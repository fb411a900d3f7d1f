"""envs/metaworld with Meta-World itself: its arm is moved and looked at, its experts solve tasks over the wire."""

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
from xpl.poses import transform
from xpl_cli.basics.errors import ExitCode
from xpl_cli.packages import environments

ENV = build.ROOT / "envs" / "metaworld"
MANIFEST = environments.manifest(ENV).data
ROBOT = MANIFEST["embodiments"][0]
PYTHON = build.interpreter("metaworld", locks=ENV)

pytestmark = peers.needed("metaworld", PYTHON)


@pytest.fixture(scope="module")
def looked() -> dict[str, Any]:
    """Return what a look at the simulator found; without pictures, which a machine may not draw."""
    return peers.look("metaworld", PYTHON, ROBOT)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("way", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_a_command_along_an_axis_moves_the_tool_along_it(looked: dict[str, Any], way: str) -> None:
    """By the 5 cm that were asked for, and by less than 1 cm to the side."""
    wanted = (0.05 if way[0] == "+" else -0.05) * np.eye(3)["xyz".index(way[1])]
    assert np.abs(np.array(looked["axes"][way]) - wanted).max() < 0.01


def test_closing_closes_and_opening_opens(looked: dict[str, Any]) -> None:
    """The standard's gripper is 0 when the fingers touch; Meta-World's action is +1 then."""
    closed, opened = looked["openings"]
    assert (closed < 0.05, opened > 0.95) == (True, True)


def test_joints_flange_and_hand_agree_by_kinematics(looked: dict[str, Any]) -> None:
    """The standard's Sawyer stands in Meta-World; quaternions are [w, x, y, z]; the hand lies 14.45 cm ahead."""
    state, (place, _) = looked["state"], looked["hand"]
    flange = Chain.from_embodiment(get_embodiment(ROBOT).data).flange(state["arm_joint_state"])
    assert np.abs(flange[:3] - state["ee_pose"][:3]).max() < 1e-5
    assert rotation.angle_between(flange[3:], state["ee_pose"][3:]) < 1e-5
    assert np.abs(transform(state["ee_pose"], [0.0, 0.0, 0.1445]) - place).max() < 1e-5


def test_changes_that_a_policy_adds_up_arrive_as_it_said_them(looked: dict[str, Any]) -> None:
    """In the setting `delta`: 5 mm are half of what an action of Meta-World moves, from the first step on."""
    assert np.abs(np.array(looked["deltas"]) - [0.5, -0.5, 0.25, 0.5]).max() < 1e-5


def test_fingers_press_when_meta_world_says_so(looked: dict[str, Any]) -> None:
    """Asked of contacts that are read at once, through an episode of a grasp."""
    touched = looked["touched"]
    assert touched["different"] == 0
    assert 5 < touched["pressed"] < touched["steps"]


@pytest.mark.slow
def test_pictures_are_upright_and_meta_worlds_own() -> None:
    """The red puck is where its projection says, what is above it is above it, and no pixel differs but by the turn."""
    seen = peers.look("metaworld", PYTHON, ROBOT, "pictures")["seen"]
    red, green, blue = seen["color"]
    assert red > 3 * max(green, blue, 1)
    assert seen["above"][1] < seen["place"][1] - 5
    assert seen["apart"] == 0.0
    red, green, blue = seen["wrist_color"]
    assert red > 3 * max(green, blue, 1)


def _played(task: str, *options: str) -> dict[str, Any]:
    place = ("--env", str(ENV), "--eval-env", f"venv:{peers.folder(PYTHON)}")
    done = xpl(
        "eval",
        str(build.ROOT / "policy" / "benchmark_expert"),
        *place,
        "--task",
        task,
        *options,
        "--json",
        cwd=build.ROOT,
    )
    assert done.returncode == ExitCode.CLEAN, done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    return report


@pytest.mark.parametrize(
    ("task", "setting"), [("reach", "clean"), pytest.param("pick-place", "delta", marks=pytest.mark.slow)]
)
def test_a_scripted_policy_solves_its_task_over_the_wire(task: str, setting: str) -> None:
    """Served, asked, its answer converted to what Meta-World takes: in both ways that a command can count."""
    report = _played(task, "--setting", setting, "--episodes", "2")
    assert report["success_rate"] == 1.0, report


@pytest.mark.slow
def test_the_environment_passes_its_audit(tmp_path: Path) -> None:
    """Every rule for environments, with one task and without pictures."""
    options = ("--python", str(PYTHON), "--set", "task=reach", "--set", "cameras=false", "--no-cache", "--json")
    done = xpl("audit", str(ENV), *options, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stdout
