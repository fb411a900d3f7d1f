"""Scripted episodes: what they show is told apart, agrees with the robot, and is the same on every machine."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from xpl import poses, rotation
from xpl.conventions.frame import mount
from xpl.conventions.point import tool
from xpl.convert import ConversionError
from xpl.embodiment import embodiment_names, get_embodiment
from xpl.kinematics import Chain
from xpl.manifest import Manifest
from xpl_cli.model_io import script, test_images
from xpl_cli.standard.validate import validate

PLACES = [(env, index) for env in (0, 2, 5) for index in (0, 1, 2, 3, 4, 100, 101)]


def scene(robot: str, size: tuple[int, int] = (12, 16)) -> script.ScriptedScene:
    calls_found = get_embodiment(robot)
    return script.ScriptedScene(calls_found, dict.fromkeys(calls_found.cameras, size))


def observed(robot: str) -> list[dict[str, Any]]:
    return scene(robot).observations(PLACES)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("robot", embodiment_names())
def test_observations_are_those_of_the_standard(robot: str) -> None:
    for obs in observed(robot):
        assert validate(obs, "observation") == []
    for arm in get_embodiment(robot).arms:
        if arm.lower is None or arm.upper is None:
            continue
        joints = np.array([obs["state"][f"{arm.prefix}arm_joint_state"] for obs in observed(robot)])
        share = (joints - arm.lower) / (arm.upper - arm.lower)
        assert 0 < share.min() < 0.06
        assert 0.94 < share.max() < 1


@pytest.mark.parametrize("robot", ["franka", "piper_single", "aloha_agilex"])
def test_poses_agree_with_joints(robot: str) -> None:
    calls_found = get_embodiment(robot)
    chain = Chain.from_embodiment(calls_found.data)
    for obs in observed(robot):
        for arm, side in zip(calls_found.arms, calls_found.data["arms"], strict=True):
            state = {
                key: np.float64(obs["state"][arm.prefix + key]) for key in ("arm_joint_state", "ee_pose", "tcp_pose")
            }
            flange = poses.compose(mount(calls_found, side), chain.flange(state["arm_joint_state"]))
            for known, given in (
                (flange, state["ee_pose"]),
                (poses.compose(flange, tool(calls_found)), state["tcp_pose"]),
            ):
                assert np.allclose(given[:3], known[:3], atol=1e-6)
                assert rotation.angle_between(given[3:], known[3:]) < 1e-5


@pytest.mark.sampled(4)
@pytest.mark.parametrize("robot", embodiment_names())
def test_quaternions_have_both_signs_and_some_lie_near_a_half_turn(robot: str) -> None:
    """No sign is decided by rounding."""
    for arm in get_embodiment(robot).arms:
        scalars = np.array([obs["state"][f"{arm.prefix}ee_pose"][3] for obs in observed(robot)])
        assert (scalars > 0).any()
        assert (scalars < 0).any()
        assert 0.02 < np.abs(scalars).min() < 0.2


def test_no_two_things_look_alike() -> None:
    observations = observed("arx_x5")
    pictured = [camera["color"].tobytes() for obs in observations for camera in obs["vision"].values()]
    assert len(set(pictured)) == len(pictured)
    for key in ("arm_joint_state", "ee_pose", "tcp_pose"):
        values = [obs["state"][f"{side}_{key}"].tobytes() for obs in observations for side in ("left", "right")]
        assert len(set(values)) == len(values)
    openings = [
        tuple(float(obs["state"][f"{side}_ee_joint_state"][0]) for side in ("left", "right")) for obs in observations
    ]
    assert all(left != right for left, right in openings)
    assert {0.0, 1.0} & {value for pair in openings for value in pair}


def test_pictures_tell_colours_directions_and_sizes_apart() -> None:
    image = test_images.test_image(0, 3, 48, 64).astype(np.int16)
    for other in (image[:, :, ::-1], image[:, ::-1], image[::-1], image[::-1, ::-1]):
        assert np.abs(other - image).mean() > 10
    assert np.abs(np.diff(image, axis=1)).mean() > 10
    middle = image[4:-4, 4:-4].mean((0, 1))
    for edge in (image[:3], image[:, :3], image[-1:]):
        assert np.abs(edge.mean((0, 1)) - middle).max() > 10


@pytest.mark.parametrize(
    ("declared", "size"),
    [
        ({}, (480, 640)),
        ({"height": None, "width": None}, (480, 640)),
        ({"height": 96, "width": 96, "exact": True}, (96, 96)),
        ({"height": 224, "width": 224}, (672, 672)),
        ({"height": 720, "width": 1280}, (720, 1280)),
    ],
)
def test_images_are_as_large_as_a_manifest_asks_for(declared: dict[str, Any], size: tuple[int, int]) -> None:
    """And larger where that is allowed: what shrinks images has to shrink them here, too."""
    manifest = Manifest.parse({"inputs": {"required": ["vision.cam_front"]}, "cameras": {"cam_front": declared}})
    assert script.cameras(manifest, get_embodiment("piper_single"))["cam_front"] == size


def test_privileged_observations_cannot_be_scripted() -> None:
    with pytest.raises(ConversionError, match="privileged"):
        script.cameras(Manifest.parse({"inputs": {"required": ["privileged"]}}), get_embodiment("piper_single"))


@pytest.mark.parametrize(
    "calls", [script.full_script(1), script.full_script(5), script.full_script(1000), script.short_script()]
)
def test_the_calls_try_what_environments_do(calls: tuple[script.Call, ...]) -> None:
    recipes = [recipe for call in calls for recipe in call.show]
    assert len(set(recipes)) == len(recipes)
    asked = [call.ask for call in calls if call.ask]
    assert {len(envs) for envs in asked} >= {1, 2}
    assert any(list(envs) != sorted(envs) for envs in asked)
    assert sum(call.reset for call in calls) >= 2
    assert any(one.show and two.show for one, two in itertools.pairwise(calls))
    assert all(index % script.EPISODE < script.EPISODE - 1 for _, index in recipes)


def test_a_history_builds_up_and_is_full() -> None:
    steps: dict[int, int] = {}
    lengths = set()
    for call in script.full_script(9):
        steps = {} if call.reset else steps
        for env, _ in call.show:
            steps[env] = steps.get(env, 0) + 1
        lengths |= {steps[env] for env in call.ask}
    assert {1, 2, 3} <= lengths
    assert max(lengths) > 9


def test_episodes_count_resets_after_something_was_shown() -> None:
    """As `xpl.Policy` seeds them."""
    calls = [script.Call(reset=True), script.Call(show=((0, 0),)), script.Call(reset=True), script.Call(reset=True)]
    calls.append(script.Call(show=((0, 100),)))
    assert [episode for _, episode in script.with_episode_numbers(calls)] == [0, 0, 1, 1, 1]
