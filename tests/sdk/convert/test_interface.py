"""A compiled block: names, histories, texts, and sentences about blocks that do not fit."""

from __future__ import annotations

import copy
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.support.adapters.model_io import CASES, observation
from xpl.action import ActionError
from xpl.convert import ConversionError, compile_interface
from xpl.embodiment import get_embodiment
from xpl.observation import ObservationError

ACTION: dict[str, Any] = {
    "reference": "absolute",
    "parts": [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 1.0}}],
}
JOINTS = {"input": "q", "parts": [{"joints": {"arm": "single"}}]}


def _interface(action_type: str = "joint", robot: str = "franka_single", chunk: int | None = None, **block: Any) -> Any:
    return compile_interface({"action": ACTION, **block}, get_embodiment(robot), action_type, chunk=chunk)


def _at(number: float) -> dict[str, Any]:
    obs = observation("franka_single")
    obs["state"]["arm_joint_state"] = np.full(7, number)
    return obs


@pytest.mark.parametrize(
    ("history", "shown", "numbers", "real"),
    [
        ({"length": 3}, 1, [0, 0, 0], [0, 0, 1]),
        ({"length": 3}, 2, [0, 0, 1], [0, 1, 1]),
        ({"length": 3}, 5, [2, 3, 4], [1, 1, 1]),
        ({"length": 3, "pad": "zeros"}, 2, [0, 0, 1], [0, 1, 1]),
        ({"length": 3, "stride": 2}, 4, [0, 1, 3], [0, 1, 1]),
        ({"length": 3, "stride": 2}, 7, [2, 4, 6], [1, 1, 1]),
        ({"length": 2, "stride": 3}, 4, [0, 3], [1, 1]),
    ],
)
def test_histories_are_oldest_first(history: dict[str, Any], shown: int, numbers: list[int], real: list[int]) -> None:
    """Every stride-th observation; what was before the first is the first, or zeros, and the mask says so."""
    interface = _interface(state=[JOINTS], history={**history, "mask": "real"})
    frames = [interface.encode(_at(number)) for number in range(shown)][-interface.span :]
    batch = interface.batch([frames, frames[-1:]])
    assert batch["q"].shape == (2, len(numbers), 7)
    assert batch["q"][0, :, 0].tolist() == numbers
    assert batch["real"][0].tolist() == real
    assert batch["real"][1].tolist() == [0] * (len(numbers) - 1) + [1]


def test_zeros_stand_for_what_was_not_seen() -> None:
    interface = _interface(state=[JOINTS], history={"length": 2, "pad": "zeros"})
    assert interface.batch([[interface.encode(_at(5))]])["q"][0, :, 0].tolist() == [0, 5]


def test_what_has_no_history_shows_the_newest() -> None:
    image = {"input": "i", "cameras": ["cam_head"], "channels": "rgb", "layout": "hwc", "dtype": "uint8"}
    interface = _interface(state=[JOINTS], images=[image], history={"length": 2, "of": ["images"]})
    frames = [interface.encode(_at(number)) for number in range(2)]
    batch = interface.batch([frames])
    assert (batch["q"].shape, batch["i"].shape) == ((1, 7), (1, 2, 24, 32, 3))
    assert batch["q"][0, 0] == 1


@pytest.mark.parametrize(
    ("how", "text", "wanted"),
    [
        ({}, "Fold it.", "Fold it."),
        ({"case": "lower"}, "Fold IT.", "fold it."),
        ({"strip": ". "}, " Fold it. ", "Fold it"),
        ({"strip": " \n", "replace": {"_": " ", "\n": " "}}, " Fold\nthe_cloth.\n", "Fold the cloth."),
        ({"replace": {"cloth": "CLOTH"}, "case": "lower"}, "Fold the cloth.", "fold the cloth."),
        ({"template": "{instruction}\n"}, "Fold it.", "Fold it.\n"),
        (
            {
                "template": "In: What action should the robot take to {instruction}?\nOut:",
                "case": "lower",
                "strip": ".",
            },
            "Fold it.",
            "In: What action should the robot take to fold it?\nOut:",
        ),
        ({"empty": "blank"}, "", ""),
        ({"empty": "blank", "template": "Task: {instruction}"}, "", "Task: "),
    ],
)
def test_instructions(how: dict[str, Any], text: str, wanted: str) -> None:
    interface = _interface(instruction={"input": "prompt", **how})
    encoded = interface.encode(observation("franka_single", instruction=text))
    assert interface.batch([[encoded], [encoded]]) == {"prompt": [wanted, wanted]}
    assert interface.batch([encoded, encoded]) == {"prompt": [wanted, wanted]}


def test_a_model_that_needs_an_instruction_refuses_none() -> None:
    with pytest.raises(ObservationError, match="no instruction"):
        _interface(instruction={"input": "prompt"}).encode(observation("franka_single", instruction=""))


def test_texts_are_taken_apart_again() -> None:
    interface = _interface(instruction={"input": "prompt", "template": "do: {instruction}\n"})
    obs = observation("franka_single", instruction="Fold it.")
    assert (
        interface.observe(interface.encode(obs), observation("franka_single", 1, instruction="x"))["instruction"]
        == "Fold it."
    )


def test_continuous_signs_follow_the_step_before() -> None:
    """The numbers q and -q are one rotation; a model that has seen one goes on seeing it."""
    part = {"rotation": {"arm": "single", "form": "quaternion_wxyz", "sign": "continuous"}}
    interface = _interface(state=[{"input": "q", "parts": [part]}])
    angles = np.linspace(0, 2 * np.pi, 9)
    memory: dict[str, np.ndarray] = {}
    seen = []
    for index, angle in enumerate(angles):
        obs = observation("franka_single")
        turn = np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0]) * (-1) ** index
        obs["state"]["ee_pose"] = np.concatenate((np.zeros(3), turn))
        seen.append(interface.encode(obs, memory)["q"])
    assert seen[0][0] == 1
    assert all(one @ other > 0.9 for one, other in pairwise(seen))
    assert seen[-1][0] == pytest.approx(-1)


@pytest.mark.parametrize(("sign", "first"), [("any", -0.6), ("positive_w", 0.6)])
def test_signs_of_quaternions(sign: str, first: float) -> None:
    part = {"rotation": {"arm": "single", "form": "quaternion_xyzw", "sign": sign}}
    obs = observation("franka_single")
    obs["state"]["ee_pose"] = np.array([0, 0, 0, -0.6, 0.8, 0, 0])
    assert _interface(state=[{"input": "q", "parts": [part]}]).encode(obs)["q"][3] == pytest.approx(first)


# -- what does not fit -------------------------------------------------------------------------------------------------

GRIPPER: Any = ACTION["parts"][1]


def _state(part: dict[str, Any]) -> dict[str, Any]:
    return {"state": [{"input": "q", "parts": [part]}]}


def _changed(**more: Any) -> dict[str, Any]:
    return {"action": {**ACTION, **more}}


UNFIT: list[tuple[dict[str, Any], str]] = [
    (_changed(parts=[{"joints": {"arm": "left"}}, GRIPPER]), "model_io.action, joints left: franka_single"),
    (_changed(parts=[GRIPPER]), "model_io.action .* no part gives arm_joint_state"),
    (_changed(parts=[*ACTION["parts"], GRIPPER]), "model_io.action has a part twice: gripper single"),
    (_changed(parts=[*ACTION["parts"], {"position": {"arm": "single"}}]), "model_io.action has position single"),
    (_changed(pad=7), "model_io.action.pad is 7, but its parts have 8 values"),
    (_changed(steps=4), "model_io.action.steps is 4, and temporal.chunk 8"),
    (_changed(normalize={"unknown": "ask the authors"}), r"action.normalize \(ask the authors\)"),
    (
        _changed(normalize={"rule": "mean_std", "file": "gone.json"}),
        "model_io.action.normalize names the file gone.json",
    ),
    (_state({"joints": {"arm": "single", "sign": [1, -1]}}), "model_io.state q, joints single: sign has 2 entries"),
    (_state({"joints": {"arm": "single", "names": ["a"]}}), "model_io.state q, joints single: .* got a"),
    (_state({"hand": {"arm": "single"}}), "model_io.state q, hand single: .* say gripper"),
    (_state({"gripper": {"arm": "single", "closed": 1, "open": 1}}), "model_io.state q, gripper single: .* the same"),
    (_state({"gripper": {"arm": "single", "closed": [1, 2], "open": 1}}), "model_io.state q, gripper single: 2 values"),
    (
        _state({"rotation": {"arm": "single", "form": "matrix", "sign": "positive_w"}}),
        "model_io.state q, rotation .* sign",
    ),
    (_state({"rotation": {"arm": "single", "form": "euler", "euler": "xxy"}}), "model_io.state q, rotation .* euler"),
    ({"state": [JOINTS, JOINTS]}, "model_io: an input is named twice: q"),
    ({"state": [JOINTS], "history": {"length": 2, "mask": "q"}}, "model_io: an input is named twice: q"),
]


@pytest.mark.parametrize(("block", "told"), UNFIT)
def test_a_block_that_does_not_fit_is_refused(block: dict[str, Any], told: str) -> None:
    with pytest.raises(ConversionError, match=told):
        _interface(chunk=8, **block)


def test_a_hand_is_no_gripper_and_what_is_not_known_is_no_frame() -> None:
    gripper = {"gripper": {"arm": "left", "closed": 0, "open": 1}}
    hand = get_embodiment("tianji_marvin_wuji")
    for part, told in (
        (gripper, "model_io.state s, gripper left: .* say hand"),
        ({"position": {"arm": "left", "frame": "base"}}, "model_io.state s, position left: .* frame: world"),
        ({"position": {"arm": "left", "point": "tcp"}}, "model_io.state s, position left: .* point: flange"),
        ({"joints": {"arm": "left", "names": ["a"]}}, "model_io.state s, joints left: .* leave names out"),
    ):
        model_io = {**CASES["hands, absolute"].model_io, "state": [{"input": "s", "parts": [part]}]}
        with pytest.raises(ConversionError, match=told):
            compile_interface(model_io, hand, "joint")


def test_a_change_in_the_moving_frame_needs_the_rotation() -> None:
    position = {"position": {"arm": "single", "applied": "body"}}
    with pytest.raises(
        ConversionError, match=r"model_io.action, position single: applied: body needs the arm's rotation"
    ):
        _interface("ee", action={"reference": "delta_state", "parts": [position, GRIPPER]})
    turn = {"rotation": {"arm": "single", "form": "matrix", "point": "tcp"}}
    with pytest.raises(ConversionError, match="position single: its point and frame differ"):
        _interface("ee", action={"reference": "delta_state", "parts": [position, turn, GRIPPER]})


@pytest.mark.parametrize(
    ("raw", "told"),
    [
        (np.zeros((8, 7)), "expected steps of 8 numbers, the model gave the shape .8, 7."),
        (np.zeros((7, 8)), "expected at least 8 steps .first 0, and those used., the model gave the shape .7, 8."),
        (np.zeros(8), "expected at least 8 steps"),
        (np.full((8, 8), np.nan), "the model gave a number that is not finite"),
    ],
)
def test_an_answer_that_does_not_fit_is_refused(raw: np.ndarray, told: str) -> None:
    action = copy.deepcopy(ACTION)
    action["parts"][1]["gripper"]["threshold"] = 0.5
    with pytest.raises(ConversionError, match=f"model_io.action: {told}"):
        _interface(chunk=8, action=action).decode(raw, observation("franka_single"))


def test_what_is_no_rotation_names_its_part() -> None:
    parts = [{"rotation": {"arm": "single", "form": "rot6d_rows"}}, GRIPPER]
    interface = _interface("ee", action={"reference": "absolute", "parts": parts})
    with pytest.raises(ConversionError, match=r"model_io.action, rotation single: .* no rotation"):
        interface.decode(np.zeros((1, 7)), observation("franka_single"))
    with pytest.raises(ActionError):
        interface.decode(np.array([[1, 0, 0, 0, 1, 0, 55.0]]), observation("franka_single"))


def test_an_observation_that_lacks_something_is_refused() -> None:
    interface = _interface(state=[JOINTS])
    for state, told in (
        ({}, "no 'arm_joint_state', which the model_io block reads"),
        ({"arm_joint_state": np.zeros(6)}, r"shape \(6,\), expected \(7,\)"),
        ({"arm_joint_state": np.full(7, np.inf)}, "not finite"),
        ({"arm_joint_state": ["0.5"] * 7}, "arm_joint_state holds <U3, expected numbers"),
        ({"arm_joint_state": [[0.5], 0.5]}, "lists of unequal lengths, expected 7 numbers"),
        ({"arm_joint_state": [None] * 7}, "arm_joint_state holds object, expected numbers"),
    ):
        with pytest.raises(ObservationError, match=told):
            interface.encode({"state": state})
    with pytest.raises(ObservationError, match="no 'state' map"):
        interface.encode({})
    with pytest.raises(ConversionError, match="no input q"):
        interface.observe({}, observation("franka_single"))
