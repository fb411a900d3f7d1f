"""envs/libero with LIBERO itself: replayed in LIBERO's own wrapper, and its arm moves as commanded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.environments.benchmarks import peers
from xpl import get_embodiment, rotation
from xpl.conventions import point
from xpl.kinematics import Chain
from xpl.poses import compose

LIBERO = peers.Benchmark("libero")

pytestmark = peers.patient


@pytest.mark.parametrize("suite", LIBERO.manifest["splits"])
def test_a_suite_has_tasks_that_are_listed_with_its_step_limit(suite: str) -> None:
    """One limit for each suite and what was made from it, as everybody plays them."""
    limits = {LIBERO.manifest["tasks"][task]["max_steps"] for task in LIBERO.manifest["splits"][suite]}
    origin = next(name for name in ("spatial", "object", "goal", "10", "90") if suite.startswith(f"libero_{name}"))
    assert limits == {{"spatial": 220, "object": 280, "goal": 300, "10": 520, "90": 400}[origin]}
    assert {LIBERO.manifest["tasks"][task]["suite"] for task in LIBERO.manifest["splits"][suite]} == {suite}


@pytest.fixture(scope="module")
def glimpsed() -> Any:
    """Return the observations of one scene, loaded and run once."""
    return LIBERO.look("glimpse")["glimpse"]


@LIBERO.needed
def test_one_task_is_played(glimpsed: Any) -> None:
    """From one of its 50 initial states the tool goes where it is sent, the fingers close, and nothing is solved."""
    along, *aside = glimpsed["travelled"]
    assert along > 0.03
    assert np.abs(aside).max() < 0.005
    assert glimpsed["state"]["ee_joint_state"][0] < 0.5
    assert glimpsed["states"] == 50
    expected = {
        "task": "libero_spatial_0",
        "seed": 0,
        "steps": 8,
        "success": False,
        "end_reason": None,
        "corrections": {},
    }
    assert {name: glimpsed["result"][name] for name in expected} == expected


@LIBERO.needed
def test_its_joints_and_poses_agree_by_kinematics(glimpsed: Any) -> None:
    """While it moves: LIBERO's own poses are a step of physics behind its joints then."""
    _agree(glimpsed, within=1e-3)


@LIBERO.needed
def test_its_picture_is_upright(glimpsed: Any) -> None:
    if "not_drawn" in glimpsed:
        pytest.skip(f"not run: {glimpsed['not_drawn']}")
    _is_upright(glimpsed["seen"])


@pytest.fixture(scope="module")
def looked() -> Any:
    """Return observations of the simulator."""
    return LIBERO.look("moved", "deltas")


@LIBERO.needed
@pytest.mark.slow
def test_what_was_played_here_is_the_same_in_liberos_own_wrapper_bit_by_bit(looked: Any) -> None:
    """Its initial state, its dummy steps, and every state after a command; and random actions solve nothing."""
    assert looked["moved"]["replayed"] == {"steps": 26, "different": 0}
    assert looked["moved"]["guessed"] == 0


@LIBERO.needed
@pytest.mark.slow
def test_commands_move_and_turn_the_tool_and_the_fingers(looked: Any) -> None:
    """By 5 cm and 0.3 rad in the world, whichever way the hand looks; LIBERO's gripper is +1 when the fingers touch."""
    assert peers.move_along_axes(looked["moved"]["axes"], 0.05, within=0.005)
    assert np.abs(np.array(looked["moved"]["turns"]) - 0.3 * np.eye(3)).max() < 0.02
    closed, opened = looked["moved"]["openings"]
    assert (closed < 0.05, opened > 0.95) == (True, True)


@LIBERO.needed
@pytest.mark.slow
def test_joints_and_flange_agree_by_kinematics(looked: Any) -> None:
    _agree(looked["moved"], within=1e-6)


def _agree(poses: Any, within: float) -> None:
    """Poses are those that LIBERO observes, of the hand, whose quaternions are [x, y, z, w] there."""
    state = poses["state"]
    flange = Chain.from_embodiment(get_embodiment(LIBERO.robots[0]).data).flange(state["arm_joint_state"])
    assert peers.same_pose(compose(np.concatenate(poses["base"]), flange), state["ee_pose"], within)
    x, y, z, w = poses["theirs"]["quat"]
    assert rotation.angle_between([w, x, y, z], state["tcp_pose"][3:]) < 1e-6
    assert np.abs(np.array(poses["theirs"]["pos"]) - state["tcp_pose"][:3]).max() < 1e-6
    hand = compose(np.array(state["ee_pose"]), point.tool(get_embodiment(LIBERO.robots[0])))
    assert peers.same_pose(hand, state["tcp_pose"], 1e-6)


@LIBERO.needed
@pytest.mark.slow
def test_changes_that_a_policy_adds_up_arrive_as_it_said_them(looked: Any) -> None:
    """In the setting `delta`: 25 mm are half of what an action of LIBERO moves, by its controller's own range."""
    assert looked["moved"]["range"] == [0.05] * 3 + [0.5] * 3
    assert np.abs(np.array(looked["deltas"]) - [0.5, -0.5, 0.25, 0, 0, 0, 0.5]).max() < 1e-5


@LIBERO.needed
@pytest.mark.slow
def test_pictures_are_upright() -> None:
    """Those that LIBERO draws for policies."""
    observed = LIBERO.look("seen")["seen"]
    assert observed.pop("observed")
    _is_upright(observed)


def _is_upright(observed: Any) -> None:
    """Three objects are in the pixels where their projection says, and none where it would be upside down."""
    assert observed.pop("raw")
    assert observed == {name: [True, False] for name in ("plate_1", "cookies_1", "akita_black_bowl_1")}


@LIBERO.needed
@pytest.mark.slow
def test_the_environment_passes_its_audit(tmp_path: Path) -> None:
    LIBERO.audit(tmp_path, task="libero_goal_7")
