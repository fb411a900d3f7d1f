"""Joints in the model's order: of one arm in one part, or of several arms in turn, a part for each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xpl.convert import ConversionError, Interface, compile_interface
from xpl.embodiment import get_embodiment

ROBOT = get_embodiment("arx_x5")
NAMES = list(ROBOT.arms[0].joint_names or ())
IN_TURN = [{"joints": {"arm": arm, "names": [name]}} for name in NAMES for arm in ("left", "right")]
GRIPPERS = [{"gripper": {"arm": arm, "closed": 0, "open": 1}} for arm in ("left", "right")]


def _interface(parts: list[dict[str, Any]], reference: str = "absolute") -> Interface:
    vector = [*parts, *GRIPPERS]
    model_io = {"state": [{"input": "q", "parts": vector}], "action": {"reference": reference, "parts": vector}}
    return compile_interface(model_io, ROBOT, "joint")


def _state(draw: np.random.Generator) -> dict[str, np.ndarray]:
    found = {f"{arm}_arm_joint_state": draw.uniform(-0.4, 0.4, 6) for arm in ("left", "right")}
    return found | {f"{arm}_ee_joint_state": draw.uniform(0, 1, 1) for arm in ("left", "right")}


@pytest.mark.parametrize("reference", ["absolute", "delta_state", "cumulative"])
def test_joints_of_two_arms_stand_in_turn(reference: str) -> None:
    """Number 2 k is joint k of the left arm, number 2 k + 1 that of the right one; commands come back as they were."""
    interface, draw = _interface(IN_TURN, reference), np.random.default_rng(1)
    state = _state(draw)
    read = interface.encode({"state": state})["q"]
    assert np.allclose(read[0:12:2], state["left_arm_joint_state"], atol=1e-6)
    assert np.allclose(read[1:12:2], state["right_arm_joint_state"], atol=1e-6)
    steps = [_state(draw) for _ in range(3)]
    again = interface.action.decode(interface.action.encode(steps, state), state)
    for step, other in zip(steps, again, strict=True):
        assert all(np.allclose(step[key], other[key], atol=1e-6) for key in step)


def test_words_of_a_part_are_of_its_joints_only() -> None:
    parts = [
        {"joints": {"arm": "left", "names": NAMES[3:][::-1], "unit": "deg", "sign": [1, -1, 1]}},
        {"joints": {"arm": "right"}},
        {"joints": {"arm": "left", "names": NAMES[:3], "offset": [0.1, 0.2, 0.3]}},
    ]
    interface, state = _interface(parts), _state(np.random.default_rng(2))
    read, left = interface.encode({"state": state})["q"], state["left_arm_joint_state"]
    assert np.allclose(read[:3], np.rad2deg(left[[5, 4, 3]]) * [1, -1, 1], atol=1e-5)
    assert np.allclose(read[9:12], left[:3] + np.array([0.1, 0.2, 0.3]), atol=1e-6)


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        (IN_TURN[:-1], "expected each joint of right_arm_joint_state once"),
        (
            [*IN_TURN, {"joints": {"arm": "left", "names": NAMES[:2]}}],
            "expected each joint of left_arm_joint_state once",
        ),
        (
            [{"joints": {"arm": "left", "names": ["elbow"]}}, {"joints": {"arm": "right"}}],
            "expected joints of the robot",
        ),
        ([{"joints": {"arm": "left", "names": NAMES[:5]}}, {"joints": {"arm": "right"}}], "joints left"),
    ],
)
def test_a_joint_that_is_left_out_or_stands_there_twice_is_told(parts: list[dict[str, Any]], told: str) -> None:
    with pytest.raises(ConversionError, match=told):
        _interface(parts)
