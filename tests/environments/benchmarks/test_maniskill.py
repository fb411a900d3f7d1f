"""envs/maniskill with ManiSkill itself: its arms move as commanded, its planners solve tasks over the wire."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.interop import build
from tests.environments.benchmarks import peers
from xpl import get_embodiment
from xpl.environment import Environment
from xpl.kinematics import Chain
from xpl.manifest import EnvManifest
from xpl.poses import compose
from xpl.process.modules import load_module
from xpl.rendering import VULKAN_COMPLAINTS, RendererMissingError, choose_vulkan

MANISKILL = peers.Benchmark("maniskill")
MANIFEST = MANISKILL.manifest
PANDA, STICK, SO100, PAIR = MANISKILL.robots
pytestmark = peers.patient
_ASKED = """
import sys
sys.path.insert(0, {root!r})
from xpl.rendering import choose_vulkan
choose_vulkan()
import sapien
sapien.render.RenderMaterial()
"""


@pytest.fixture(scope="module")
def played() -> None:
    """Stop tests of the simulator where it is not there, or has no Vulkan device."""
    if MANISKILL.python is None:
        pytest.skip(MANISKILL.needed.kwargs["reason"])
    command = [str(MANISKILL.python), "-c", _ASKED.format(root=str(build.ROOT))]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=peers.LIMIT_S)
    if done.returncode and any(complaint in done.stderr for complaint in VULKAN_COMPLAINTS):
        pytest.skip(peers.NO_VULKAN)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def looked(played: None) -> Any:
    """Return what was seen of each robot, and what is refused."""
    parts = ("angles", "angle_changes", "stick", "so100", "jaw", "solved", "pair", "refused", "tasks")
    return MANISKILL.look("poses", "changes", *parts)


def _offered(task: str) -> list[str]:
    return [robot for robot in MANIFEST["embodiments"] if robot not in MANIFEST["tasks"][task]["unsupported"]]


def test_each_task_that_runs_without_a_download_is_listed_with_its_robot_or_the_reason() -> None:
    """22 tasks: 19 for one robot each, and three whose robots the standard does not describe."""
    without = {task: _offered(task) for task, facts in MANIFEST["tasks"].items() if "assets" not in facts}
    assert len(without) == 22
    assert sorted(map(len, without.values())) == [0] * 3 + [1] * 19


def test_a_driver_is_taken_from_the_named_folder_and_never_instead_of_vulkans_own_variables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """XPL_MESA names a folder that mesa.sh filled; a wrong one is an error that names it."""
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XPL_MESA", str(tmp_path))
    with pytest.raises(RendererMissingError, match=str(tmp_path)):
        choose_vulkan()
    (tmp_path / "lvp_icd.json").touch()
    monkeypatch.setenv("VK_DRIVER_FILES", "theirs")
    choose_vulkan()
    assert "VK_ICD_FILENAMES" not in os.environ
    monkeypatch.delenv("VK_DRIVER_FILES")
    monkeypatch.setenv("VK_ICD_FILENAMES", "")
    choose_vulkan()
    assert os.environ["VK_ICD_FILENAMES"] == str(tmp_path / "lvp_icd.json")


def test_without_maniskill_one_sentence_says_how_to_install_it() -> None:
    client = load_module(MANISKILL.env / "client.py")
    with pytest.raises(RuntimeError, match="xpl install maniskill"):
        client.make({"task": "PickCube", "embodiment": PANDA})


@pytest.mark.parametrize(("robot", "task"), [(PANDA, "PickCube"), (SO100, "PickCubeSO100"), (PAIR, "TwoRobotPickCube")])
def test_a_task_is_refused_for_another_robot_with_the_reason(robot: str, task: str) -> None:
    wrong = next(other for other in MANIFEST["embodiments"] if other != robot)
    with pytest.raises(ValueError, match="the task is for"):
        Environment(lambda _: None, EnvManifest.parse(MANIFEST), {"task": task, "embodiment": wrong})  # type: ignore[arg-type,return-value]


@pytest.mark.slow
def test_commands_move_and_turn_the_tool_and_the_fingers(looked: Any) -> None:
    """By 5 cm along, and 0.3 rad about, axes of the world; the gripper is 1 when it is open, as ManiSkill's is +1."""
    assert peers.move_along_axes(looked["poses"]["axes"], 0.05, within=0.001)
    assert np.abs(np.array(looked["poses"]["turns"]) - 0.3 * np.eye(3)).max() < 0.005
    closed, opened = looked["poses"]["openings"]
    assert (closed < 0.02, opened > 0.98) == (True, True)


@pytest.mark.slow
def test_changes_that_a_policy_adds_up_arrive_as_it_said_them(looked: Any) -> None:
    """5 cm are half of what an action of 1 moves, by the controller's own range, 0.02 rad a fifth, turned round."""
    changes = looked["changes"]
    assert (changes["range"], changes["fingers"]) == ([0.1, -0.1], [-0.01, 0.04])
    assert np.abs(np.array(changes["told"]) - [0.5, -0.5, 0.25, 0, 0, 0, -0.5]).max() < 1e-4
    assert np.abs(np.array(changes["turns_told"])[:, 3:6] + 0.2 * np.eye(3)).max() < 1e-4


@pytest.mark.slow
def test_changes_move_and_turn_the_tool_the_way_they_say(looked: Any) -> None:
    """ManiSkill counts them from where the arm is, which lags behind, so that less comes of them."""
    for motion in (np.array(looked["changes"][name]) for name in ("moved", "turned")):
        assert np.diag(motion).min() > 0.03
        assert np.abs(motion - np.diag(np.diag(motion))).max() < 0.002


@pytest.mark.slow
def test_an_episode_played_again_is_the_same(looked: Any) -> None:
    assert looked["poses"]["again"] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("part", "robot"), [("angles", PANDA), ("stick", STICK), ("so100", SO100)])
def test_angles_are_met_and_joints_and_poses_agree_by_kinematics(looked: Any, part: str, robot: str) -> None:
    """The standard's robots stand in ManiSkill, wherever their base is; quaternions are [w, x, y, z] in both."""
    observed = looked[part]
    assert np.abs(np.array(observed["moved"]) - observed["wanted"]).max() < 0.005
    state, base = observed["kinematics"]["state"], np.array(observed["kinematics"]["robot"])
    chain = Chain.from_embodiment(get_embodiment(robot).data)
    flange = compose(base, chain.flange(state["arm_joint_state"]))
    assert peers.same_pose(flange, state["ee_pose"])
    if robot != SO100:  # whose point between the jaws moves with them
        assert peers.same_pose(chain.tcp_from_flange(flange), observed["kinematics"]["tcp"])


@pytest.mark.slow
def test_changes_of_angles_arrive_as_they_were_said(looked: Any) -> None:
    """0.025 rad are a quarter of what an action of 1 moves."""
    observed = looked["angle_changes"]
    assert np.abs(np.array(observed["told"][:7]) - np.array(observed["wanted"]) * 2.5).max() < 1e-4
    assert (np.array(observed["moved"]) * np.array(observed["wanted"]) > 0).all()


@pytest.mark.slow
def test_the_jaw_of_an_so100_closes_and_opens(looked: Any) -> None:
    """Its tips touch at 0."""
    closed, opened = looked["jaw"]
    assert (closed < 0.01, opened > 0.1) == (True, True)


@pytest.mark.slow
def test_an_so100_goes_to_poses_that_it_can_reach(looked: Any) -> None:
    """ManiSkill commands it by angles alone: they are found here."""
    assert np.abs(np.array(looked["solved"]["up"]) - [0, 0, 0.02]).max() < 0.003
    assert np.abs(np.array(looked["solved"]["ahead"]) - [0.02, 0, 0]).max() < 0.003


@pytest.mark.slow
def test_each_of_two_arms_moves_by_its_own_command(looked: Any) -> None:
    """And stands where its description says."""
    for side, other in (("left", "right"), ("right", "left")):
        assert np.abs(np.array(looked["pair"][side][side]) - [0.05, 0, 0]).max() < 0.002
        assert np.abs(np.array(looked["pair"][side][other])).max() < 0.002
        mount = get_embodiment(PAIR).data["mounts"][side]
        assert peers.same_pose(looked["pair"]["bases"][f"{side}_"], [*mount["xyz"], *mount["quaternion"]])


@pytest.mark.slow
def test_what_cannot_be_played_says_so_in_one_sentence(looked: Any) -> None:
    """Assets that ManiSkill would ask for at the terminal, and a control mode that it lacks."""
    assert looked["refused"]["assets"].startswith("NotInstalledError: PickSingleYCB needs assets")
    assert looked["refused"]["changes"].startswith("ValueError: ManiSkill commands so100 by angles alone")


@pytest.mark.slow
def test_without_a_vulkan_driver_one_sentence_says_where_to_get_one(played: None) -> None:
    """Also without images; audits call it not run."""
    message = MANISKILL.look("driver")["driver"]
    assert message.startswith("RendererMissingError: ManiSkill needs a Vulkan device even without cameras")
    assert "mesa.sh" in message


@pytest.mark.slow
def test_every_task_that_is_offered_without_a_download_plays(looked: Any) -> None:
    errors = looked["tasks"]
    assert (len(errors), {task: error for task, error in errors.items() if error}) == (19, {})


@pytest.mark.slow
def test_pictures_are_upright_and_maniskills_own(played: None) -> None:
    """A red and a green cube are where their projection says, in both cameras; a goal is rendered in `goal` alone."""
    observed = MANISKILL.look("seen")["seen"]
    assert peers.is_colored(observed["cam_head"]["A"], 0)
    assert peers.is_colored(observed["cam_head"]["B"], 1)
    assert peers.is_colored(observed["cam_wrist"]["B"], 1)
    on, above = observed["above"]
    assert above < on - 4
    assert observed["apart"] == 0.0
    hidden, visible = observed["goal"]
    assert (hidden < 50, visible > 100) == (True, True)


@pytest.mark.slow
@pytest.mark.parametrize("control", ["joint", "ee"])
def test_a_planner_solves_its_task_over_the_wire(played: None, control: str) -> None:
    MANISKILL.solve("--task", "PickCube", "--setting", "planner", "--set", f"action_type={control}")


@pytest.mark.slow
def test_the_environment_passes_its_audit(played: None, tmp_path: Path) -> None:
    MANISKILL.audit(tmp_path, task="PickCube")
