from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xpl.embodiment import get_embodiment
from xpl.observation import ObservationError, env_index, env_indices, get_image, get_instruction, pack_state

ROBOT = get_embodiment("arx_x5")
IMAGE = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)


def state() -> dict[str, Any]:
    return {
        "left_arm_joint_state": [1, 2, 3, 4, 5, 6],
        "left_ee_joint_state": [0.25],
        "right_arm_joint_state": [7, 8, 9, 10, 11, 12],
        "right_ee_joint_state": [0.75],
        "left_ee_pose": [0, 0, 0, 1, 0, 0, 0],
        "mobile": {"base_twist": [0] * 6},
    }


def test_proprioception_is_packed_in_the_order_of_an_action() -> None:
    flat = pack_state({"state": state()}, ROBOT, "joint")
    assert flat.dtype == np.float32
    assert flat.tolist() == [1, 2, 3, 4, 5, 6, 0.25, 7, 8, 9, 10, 11, 12, 0.75]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left_arm_joint_state": [1, 2]}, r"shape \(6,\)"),
        ({"left_arm_joint_state": None}, "numbers"),
        ({"left_ee_joint_state": [float("nan")]}, "NaN"),
        ({"left_ee_joint_state": [float("inf")]}, "NaN or infinity"),
    ],
)
def test_a_wrong_state_is_an_error_and_never_a_default(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ObservationError, match=message):
        pack_state({"state": {**state(), **change}}, ROBOT, "joint")


@pytest.mark.parametrize("obs", [{}, {"state": None}, {"state": [1]}, {"state": {}}])
def test_a_missing_state_is_an_error_that_lists_what_is_there(obs: dict[str, Any]) -> None:
    with pytest.raises(ObservationError, match="state"):
        pack_state(obs, ROBOT, "joint")


@pytest.mark.parametrize("spelling", ["color", "colors", "rgb", "image"])
def test_an_image_is_found_under_every_spelling(spelling: str) -> None:
    assert get_image({"vision": {"cam_head": {spelling: IMAGE, "depth": 0}}}, "cam_head") is IMAGE


def test_an_image_may_lie_directly_under_its_camera_and_may_be_lists() -> None:
    assert get_image({"vision": {"cam_head": IMAGE}}, "cam_head") is IMAGE
    listed = get_image({"vision": {"cam_head": {"color": IMAGE.tolist()}}}, "cam_head")
    assert listed.dtype == np.uint8
    assert np.array_equal(listed, IMAGE)


@pytest.mark.parametrize(
    ("vision", "message"),
    [
        (None, "no camera 'cam_head'"),
        ({"cam_wrist": {}}, "it has cam_wrist"),
        ({"cam_head": {"depth": 1}}, "no 'color'; it has depth"),
        ({"cam_head": {"color": b"\xff\xd8"}}, "still encoded"),
        ({"cam_head": {"color": np.zeros(9, np.uint8)}}, "still encoded"),
        ({"cam_head": {"color": np.zeros((2, 4, 3))}}, "uint8"),
        ({"cam_head": {"color": np.zeros((3, 2, 4), np.uint8)}}, r"\(H, W, 3\)"),
        ({"cam_head": {"color": [[[0.5, 0, 0]]]}}, "uint8"),
        ({"cam_head": {"color": [[[256, 0, 0]]]}}, "uint8"),
        ({"cam_head": {"color": [[[1, 2, 3]], []]}}, "rows of equal length"),
    ],
)
def test_a_missing_or_wrong_image_is_an_error_and_never_black(vision: Any, message: str) -> None:
    with pytest.raises(ObservationError, match=message):
        get_image({"vision": vision}, "cam_head")


@pytest.mark.parametrize(
    ("obs", "text"),
    [
        ({"instruction": "lift"}, "lift"),
        ({"instructions": ["lift", "raise"]}, "lift"),
        ({"instructions": ("lift",)}, "lift"),
        ({"instructions": np.array(["lift"])}, "lift"),
        ({"instruction": "lift", "instructions": ["raise"]}, "lift"),
        ({"instruction": None, "instructions": ["raise"]}, "raise"),
        ({"instructions": []}, None),
        ({"instruction": ""}, ""),
        ({}, None),
    ],
)
def test_the_instruction_has_two_spellings(obs: dict[str, Any], text: str | None) -> None:
    assert get_instruction(obs) == text


@pytest.mark.parametrize(
    "obs", [{"instruction": 3}, {"instruction": ["x"]}, {"instructions": "lift"}, {"instructions": [3]}]
)
def test_an_instruction_that_is_no_text_is_an_error(obs: dict[str, Any]) -> None:
    with pytest.raises(ObservationError):
        get_instruction(obs)


def test_observations_without_an_index_count_by_position() -> None:
    """If all lack it; nil is lacking it."""
    assert env_indices([{}, {"env_idx": None}, {}]) == [0, 1, 2]
    assert env_indices([{"env_idx": 7}, {"env_idx": np.int64(3)}]) == [7, 3]
    assert env_indices([]) == []


@pytest.mark.parametrize("indices", [[0, None], [None, 1], [2, 2]])
def test_a_mixed_or_repeated_index_is_an_error(indices: list[Any]) -> None:
    with pytest.raises(ObservationError):
        env_indices([{"env_idx": index} for index in indices])


@pytest.mark.parametrize("value", [True, np.True_, -1, 1.0, "1", None, [1]])
def test_an_index_is_a_non_negative_integer(value: Any) -> None:
    with pytest.raises(ObservationError, match="non-negative integer"):
        env_index(value)


def test_an_instruction_that_a_policy_follows_is_required() -> None:
    assert get_instruction({"state": {}}) is None
    with pytest.raises(ObservationError, match="no instruction, nor instructions; it has state"):
        get_instruction({"state": {}}, required=True)
    assert get_instruction({"instructions": ["fold it"]}, required=True) == "fold it"
