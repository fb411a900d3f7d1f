"""envs/libero with LIBERO itself: played again in LIBERO's own wrapper, and its arm is moved and looked at."""

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

ENV = build.ROOT / "envs" / "libero"
MANIFEST = environments.manifest(ENV).data
PYTHON = build.interpreter("libero", locks=ENV)
ROBOT = MANIFEST["embodiments"][0]

pytestmark = peers.patient
needed = peers.needed("libero", PYTHON)


@pytest.mark.parametrize("suite", MANIFEST["splits"])
def test_a_suite_has_tasks_that_are_listed_with_its_step_limit(suite: str) -> None:
    """One limit for each suite and what was made from it, as everybody plays them."""
    limits = {MANIFEST["tasks"][task]["max_steps"] for task in MANIFEST["splits"][suite]}
    origin = next(name for name in ("spatial", "object", "goal", "10", "90") if suite.startswith(f"libero_{name}"))
    assert limits == {{"spatial": 220, "object": 280, "goal": 300, "10": 520, "90": 400}[origin]}
    assert {MANIFEST["tasks"][task]["suite"] for task in MANIFEST["splits"][suite]} == {suite}


@pytest.fixture(scope="module")
def glimpsed() -> dict[str, Any]:
    """Return what one scene shows, loaded and played once."""
    return peers.look("libero", PYTHON, ROBOT, "glimpse")


@needed
def test_one_task_is_played(glimpsed: dict[str, Any]) -> None:
    """From one of its 50 initial states the tool goes where it is sent, the fingers close, and nothing is solved."""
    along, *aside = glimpsed["travelled"]
    assert along > 0.03
    assert np.abs(aside).max() < 0.005
    assert glimpsed["state"]["ee_joint_state"][0] < 0.5
    assert glimpsed["states"] == 50
    known = {"task": "libero_spatial_0", "seed": 0, "steps": 8, "success": False, "end_reason": None, "corrections": {}}
    assert {name: glimpsed["result"][name] for name in known} == known


@needed
def test_its_joints_and_poses_agree_by_kinematics(glimpsed: dict[str, Any]) -> None:
    """While it moves: LIBERO's own numbers are a step of physics apart from ours then."""
    _agree(glimpsed, within=1e-3)


@needed
def test_its_picture_is_upright(glimpsed: dict[str, Any]) -> None:
    """As LIBERO gives it, turned upside down."""
    if "not_drawn" in glimpsed:
        pytest.skip(f"not run: {glimpsed['not_drawn']}")
    _is_upright(glimpsed["seen"])


@pytest.mark.slow
@needed
def test_what_was_played_here_is_the_same_in_liberos_own_wrapper_bit_by_bit() -> None:
    """Its initial state, its dummy steps, and every state after a command of ours: positions, speeds, time."""
    assert peers.look("libero", PYTHON, ROBOT)["replayed"] == {"steps": 26, "different": 0}


@pytest.fixture(scope="module")
def looked() -> dict[str, Any]:
    """Return what a look at the simulator found."""
    return peers.look("libero", PYTHON, ROBOT, "moved")


@needed
@pytest.mark.slow
@pytest.mark.parametrize("way", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_a_command_along_an_axis_moves_the_tool_along_it(looked: dict[str, Any], way: str) -> None:
    """By the 5 cm that were asked for."""
    wanted = (0.05 if way[0] == "+" else -0.05) * np.eye(3)["xyz".index(way[1])]
    assert np.abs(np.array(looked["axes"][way]) - wanted).max() < 0.005


@needed
@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
def test_a_command_turns_the_tool_about_an_axis_of_the_world(looked: dict[str, Any], axis: int) -> None:
    """By the 0.3 rad that were asked for, whichever way the hand looks."""
    assert np.abs(np.array(looked["turns"][axis]) - 0.3 * np.eye(3)[axis]).max() < 0.02


@needed
@pytest.mark.slow
def test_closing_closes_and_opening_opens(looked: dict[str, Any]) -> None:
    """The standard's gripper is 0 when the fingers touch; LIBERO's action is +1 then."""
    closed, opened = looked["openings"]
    assert (closed < 0.05, opened > 0.95) == (True, True)


@needed
@pytest.mark.slow
def test_joints_and_flange_agree_by_kinematics(looked: dict[str, Any]) -> None:
    """Where it stands still."""
    _agree(looked, within=1e-6)


def _agree(looked: dict[str, Any], within: float) -> None:
    """Quaternions are [w, x, y, z]; LIBERO's own, of the hand, are [x, y, z, w]."""
    state, (place, turn) = looked["state"], (np.array(part) for part in looked["base"])
    flange = Chain.from_embodiment(get_embodiment(ROBOT).data).flange(state["arm_joint_state"])
    assert np.abs(place + rotation.rotate(turn, flange[:3]) - state["ee_pose"][:3]).max() < 1e-3
    assert rotation.angle_between(rotation.multiply(turn, flange[3:]), state["ee_pose"][3:]) < 1e-3
    x, y, z, w = looked["theirs"]["robot0_eef_quat"]
    assert rotation.angle_between([w, x, y, z], state["tcp_pose"][3:]) < 1e-3
    assert np.abs(np.array(looked["theirs"]["robot0_eef_pos"]) - state["tcp_pose"][:3]).max() < within


@needed
@pytest.mark.slow
def test_changes_that_a_policy_adds_up_arrive_as_it_said_them(looked: dict[str, Any]) -> None:
    """In the setting `delta`: 25 mm are half of what an action of LIBERO moves, by its controller's own range."""
    assert looked["range"] == [0.05] * 3 + [0.5] * 3
    assert np.abs(np.array(looked["deltas"]) - [0.5, -0.5, 0.25, 0, 0, 0, 0.5]).max() < 1e-5


@needed
@pytest.mark.slow
def test_random_actions_solve_nothing(looked: dict[str, Any]) -> None:
    """Three episodes."""
    assert looked["guessed"] == 0


@needed
@pytest.mark.slow
@pytest.mark.timeout(900)  # 0.3 s of both cores for each step
def test_pictures_are_upright() -> None:
    """Those that LIBERO draws for policies."""
    seen = peers.look("libero", PYTHON, ROBOT, "pictures")["seen"]
    assert seen.pop("observed")
    _is_upright(seen)


def _is_upright(seen: dict[str, Any]) -> None:
    """Three objects are in the pixels where their projection says, and none where it would be upside down."""
    assert seen.pop("raw")
    assert seen == {name: [True, False] for name in ("plate_1", "cookies_1", "akita_black_bowl_1")}


@needed
@pytest.mark.slow
@pytest.mark.timeout(900)  # it compiles code, and loads a scene in each of many resets
def test_the_environment_passes_its_audit(tmp_path: Path) -> None:
    """Every rule for environments, with one task and without pictures."""
    options = ("--python", str(PYTHON), "--set", "task=libero_goal_7", "--set", "cameras=false", "--no-cache", "--json")
    done = xpl("audit", str(ENV), *options, cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, json.loads(done.stdout)
