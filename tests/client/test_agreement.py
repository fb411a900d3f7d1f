from __future__ import annotations

from typing import Any

import pytest

from xpl.client.agreement import differences, format_differences, policy_announcement
from xpl.manifest import Manifest

POLICY = {
    "name": "Subject",
    "embodiments": ["franka_single", "arx_x5"],
    "embodiment": "arx_x5",
    "action_types": ["joint", "ee"],
    "action_type": "joint",
    "control_frequency": 30,
    "inputs": ["vision", "state", "instruction"],
}
ENVIRONMENT = {
    "embodiment": "arx_x5",
    "action_type": "joint",
    "control_frequency": 30.0,
    "inputs": ["instruction", "vision", "state", "depth"],
}


def test_an_environment_that_offers_what_is_needed_fits() -> None:
    assert differences(POLICY, ENVIRONMENT) == []


@pytest.mark.parametrize(
    ("field", "offered", "wanted"),
    [
        ("embodiment", "franka_single", "arx_x5"),
        ("embodiment", "my_robot", "arx_x5"),
        ("action_type", "ee", "joint"),
        ("control_frequency", 25, 30),
        ("inputs", ["state"], POLICY["inputs"]),
        ("inputs", [], POLICY["inputs"]),
    ],
)
def test_each_difference_has_both_sides(field: str, offered: Any, wanted: Any) -> None:
    (found,) = differences(POLICY, {**ENVIRONMENT, field: offered})
    assert (found["field"], found["policy"], found["environment"]) == (field, wanted, offered)
    assert format_differences([found]) == f"policy and environment do not fit: {found['message']}"


@pytest.mark.parametrize(
    ("field", "declared", "offered"),
    [("embodiment", ["franka_single", "piper"], "arx_x5"), ("action_type", ["joint"], "ee")],
)
def test_without_a_choice_what_the_manifest_declares_counts(field: str, declared: list[str], offered: str) -> None:
    policy = {**POLICY, field: None, f"{field}s": declared}
    (found,) = differences(policy, {**ENVIRONMENT, field: offered})
    assert (found["field"], found["policy"]) == (field, declared)
    assert differences(policy, {**ENVIRONMENT, field: declared[0]}) == []


@pytest.mark.parametrize(
    ("needed", "shown", "fits"),
    [
        ({"width": 640, "height": 480}, {"width": 640, "height": 480}, True),
        ({"width": 640, "height": 480}, {"width": 1280, "height": 720}, True),
        ({"width": None, "height": None}, {"width": 8, "height": 8}, True),
        ({"width": 640, "height": 480}, {"width": 640, "height": 360}, False),
        ({"width": 320, "height": None}, {"width": 64, "height": 48}, False),
        ({"width": 64, "height": 48, "exact": True}, {"width": 128, "height": 96}, False),
    ],
)
def test_images_are_at_least_as_large_as_the_policy_needs_them(
    needed: dict[str, Any], shown: dict[str, int], fits: bool
) -> None:
    """Of that very size where it takes no other; a camera that is not shown is a matter of the inputs."""
    policy = {**POLICY, "cameras": {"cam_head": needed, "cam_left_wrist": {"width": 9999, "height": 9999}}}
    found = differences(policy, {**ENVIRONMENT, "cameras": {"cam_head": shown}})
    assert [one["field"] for one in found] == ([] if fits else ["cameras"])


@pytest.mark.parametrize("field", ["embodiment", "action_type", "control_frequency", "inputs"])
def test_what_one_side_does_not_say_is_not_compared(field: str) -> None:
    strange = {**ENVIRONMENT, field: None}
    assert differences(POLICY, strange) == []
    del strange[field]
    assert differences(POLICY, strange) == []
    silent = {**POLICY, field: None, f"{field}s": None}
    assert differences(silent, {**ENVIRONMENT, field: "anything"}) == []
    for name in (field, f"{field}s"):
        silent.pop(name)
    assert differences(silent, {**ENVIRONMENT, field: "anything"}) == []
    assert differences({}, ENVIRONMENT) == differences(POLICY, {}) == []


@pytest.mark.parametrize("chosen", ["arx_x5", "dual_x5", None])
@pytest.mark.parametrize("declared", [["arx_x5"], ["dual_x5"], None])
@pytest.mark.parametrize("offered", ["arx_x5", "dual_x5"])
def test_an_embodiment_has_one_name_behind_its_aliases(chosen: Any, declared: Any, offered: str) -> None:
    """Whoever uses which; also a policy that was announced by another implementation."""
    announced = {**POLICY, "embodiment": chosen, "embodiments": declared}
    assert differences(announced, {**ENVIRONMENT, "embodiment": offered}) == []
    told = policy_announcement(Manifest.parse({"embodiments": declared}), {"env_cfg_type": chosen})
    assert differences(told, {**ENVIRONMENT, "embodiment": offered}) == []


def test_needs_are_read_from_manifest_and_configuration() -> None:
    manifest = {
        "embodiments": ["dual_x5"],
        "action_types": ["joint"],
        "control_frequency": 20,
        "inputs": {"required": ["state"], "optional": ["vision"]},
        "cameras": {"cam_head": {"width": 64, "height": 48}},
    }
    config = {"policy_name": "Subject", "env_cfg_type": "dual_x5", "action_type": "joint", "seed": 0}
    assert policy_announcement(Manifest.parse(manifest), config) == {
        "name": "Subject", "embodiments": ["arx_x5"], "embodiment": "arx_x5", "action_types": ["joint"],
        "action_type": "joint", "control_frequency": 20, "inputs": ["state"],
        "cameras": {"cam_head": {"width": 64, "height": 48}},
    }  # fmt: skip
    assert set(policy_announcement(Manifest(), {}).values()) == {None}
    assert policy_announcement(Manifest(), {"env_cfg_type": "my_robot"})["embodiment"] is None


@pytest.mark.parametrize("noise", [3, "text", [["arx_x5"]], {"a": 1}, True])
def test_whatever_a_peer_announces_is_compared_or_left(noise: Any) -> None:
    for field in ENVIRONMENT:
        differences(POLICY, {**ENVIRONMENT, field: noise})
    for field in POLICY:
        differences({**POLICY, field: noise}, ENVIRONMENT)
