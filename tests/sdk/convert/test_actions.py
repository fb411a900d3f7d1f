"""What an action is counted from, joint words, grippers and poses: each word computed by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.adapters.model_io import observation
from xpl.convert import compile_interface
from xpl.embodiment import get_embodiment

HOME = np.array([0.1, 0.2, 0.3, -0.4, 0.5, 0.6, 0.7])
JOINTS = {"joints": {"arm": "single"}}
GRIPPER = {"gripper": {"arm": "single", "closed": 0.0, "open": 1.0}}
STATE = {"arm_joint_state": HOME, "ee_joint_state": np.array([0.25]), "ee_pose": np.array([0.4, 0, 0.3, 1, 0, 0, 0.0])}
QUARTER = Rotation.from_euler("z", 90, degrees=True).as_quat(scalar_first=True)


def _action(parts: list[Any], kind: str = "joint", robot: str = "franka_single", **more: Any) -> Any:
    block = {"action": {"reference": "absolute", "parts": parts, **more}}
    return compile_interface(block, get_embodiment(robot), kind).action


def _joints(reference: str, **more: Any) -> tuple[Any, np.ndarray]:
    return _action([JOINTS, GRIPPER], reference=reference, **more), np.full((3, 8), 0.1)


def _arm(steps: list[dict[str, np.ndarray]]) -> list[float]:
    return [round(float(step["arm_joint_state"][0] - HOME[0]), 5) for step in steps]


@pytest.mark.parametrize(
    ("reference", "moved"),
    [
        ("absolute", [0.0, 0.0, 0.0]),  # 0.1 is where the first joint stands
        ("delta_state", [0.1, 0.1, 0.1]),
        ("cumulative", [0.1, 0.2, 0.3]),
        ("delta_command", [0.1, 0.2, 0.3]),
    ],
)
def test_each_reference(reference: str, moved: list[float]) -> None:
    """The gripper is absolute whatever the joints are, since it does not say otherwise."""
    action, raw = _joints(reference)
    steps = action.decode(raw, STATE)
    assert _arm(steps) == moved
    assert [float(step["ee_joint_state"][0]) for step in steps] == pytest.approx([0.1] * 3)


@pytest.mark.parametrize(
    ("reference", "moved"),
    [("delta_state", [0.1, 0.1]), ("cumulative", [0.2, 0.3]), ("delta_command", [0.2, 0.3]), ("absolute", [0, 0])],
)
def test_steps_before_the_first_count_and_are_not_handed_on(reference: str, moved: list[float]) -> None:
    action, raw = _joints(reference, first=1, steps=2)
    assert _arm(action.decode(raw, STATE)) == moved


@pytest.mark.parametrize(("reference", "second"), [("delta_command", 0.4), ("cumulative", 0.1), ("delta_state", 0.1)])
def test_only_one_reference_goes_on_over_chunks(reference: str, second: float) -> None:
    """The command before is remembered; the state at the call is a new one each time."""
    action, raw = _joints(reference)
    memory: dict[str, np.ndarray] = {}
    action.decode(raw, STATE, memory)
    assert _arm(action.decode(raw, STATE, memory))[0] == second


def test_a_gripper_is_a_delta_if_it_says_so() -> None:
    action = _action([JOINTS, {"gripper": {**GRIPPER["gripper"], "reference": "delta_state"}}])
    (step,) = action.decode(np.full((1, 8), 0.1), STATE)
    assert step["ee_joint_state"] == pytest.approx([0.35])


def test_joint_words() -> None:
    """ModelIO = sign * angle in unit + offset, in the model's order."""
    names = [f"joint{index}" for index in (7, 6, 5, 4, 3, 2, 1)]
    how = {
        "arm": "single",
        "names": names,
        "unit": "deg",
        "sign": [1, 1, 1, 1, 1, 1, -1],
        "offset": [0, 0, 0, 0, 0, 0, 90],
    }
    action = _action([{"joints": how}, GRIPPER])
    wanted = [np.rad2deg(HOME[index]) for index in (6, 5, 4, 3, 2, 1)] + [90 - np.rad2deg(HOME[0])]
    raw = action.encode([{key: STATE[key] for key in ("arm_joint_state", "ee_joint_state")}], STATE)
    assert raw[0] == pytest.approx([*wanted, 0.25])
    (step,) = action.decode(raw, STATE)
    assert step["arm_joint_state"] == pytest.approx(HOME, abs=1e-6)


@pytest.mark.parametrize(
    ("how", "model_io", "opening"),
    [
        ({"closed": 0.0, "open": 0.08}, [0.02], 0.25),  # metres between the fingers
        ({"closed": 1.0, "open": -1.0}, [0.5], 0.25),  # robosuite's command
        ({"closed": [0.0, 0.0], "open": [0.04, -0.04]}, [0.01, -0.01], 0.25),  # robosuite's fingers
        ({"closed": [0.0, 0.0], "open": [0.04, -0.04]}, [0.02, 0.0], 0.25),  # the best fit of both
        ({"closed": 0.0, "open": 100.0}, [25.0], 0.25),
        ({"closed": 0.0, "open": 1.0, "threshold": 0.5}, [0.51], 1.0),
        ({"closed": 0.0, "open": 1.0, "threshold": 0.5}, [0.5], 0.0),
        ({"closed": 1.0, "open": -1.0, "threshold": 0.0}, [0.3], 0.0),
        ({"closed": 1.0, "open": -1.0, "threshold": 0.0}, [-0.3], 1.0),
        ({"closed": [0.0, 0.0], "open": [0.0, -0.04], "threshold": -0.02}, [9.0, -0.03], 1.0),
    ],
)
def test_gripper_words(how: dict[str, Any], model_io: list[float], opening: float) -> None:
    """The model's values of closed and open say unit, direction and number of fingers."""
    action = _action([JOINTS, {"gripper": {"arm": "single", **how}}])
    (step,) = action.decode(np.array([[*HOME, *model_io]]), STATE)
    assert step["ee_joint_state"] == pytest.approx([opening])


@pytest.mark.parametrize(
    ("applied", "place", "turn"),
    [
        ("fixed", [0.5, 0.0, 0.3], [90, 90]),
        # Turned by 90 degrees about z: the model's x is the world's y.
        ("body", [0.4, 0.1, 0.3], [90, 90]),
    ],
)
def test_where_a_change_of_pose_is_applied(applied: str, place: list[float], turn: list[float]) -> None:
    state = {**STATE, "ee_pose": np.array([0.4, 0, 0.3, *QUARTER])}
    parts: list[Any] = [
        {"position": {"arm": "single", "applied": applied}},
        {"rotation": {"arm": "single", "form": "axis_angle", "applied": applied}},
        GRIPPER,
    ]
    action = _action(parts, "ee", reference="delta_state")
    (step,) = action.decode(np.array([[0.1, 0, 0, np.pi / 2, 0, 0, 1.0]]), state)
    assert step["ee_pose"][:3] == pytest.approx(place, abs=1e-6)
    about_z, about_x = (Rotation.from_euler(axis, angle, degrees=True) for axis, angle in zip("zx", turn, strict=True))
    wanted = about_x * about_z if applied == "fixed" else about_z * about_x
    found = Rotation.from_quat(step["ee_pose"][3:], scalar_first=True)
    assert (wanted.inv() * found).magnitude() < 1e-6


def test_a_rotation_may_change_number_by_number() -> None:
    """Both openpi and LeRobot subtract the state from the action, whatever the numbers are."""
    state = {
        **STATE,
        "ee_pose": np.array([0.4, 0, 0.3, *Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_quat(scalar_first=True)]),
    }
    parts: list[Any] = [
        {"position": {"arm": "single"}},
        {"rotation": {"arm": "single", "form": "euler", "euler": "xyz", "applied": "numbers"}},
        GRIPPER,
    ]
    (step,) = _action(parts, "ee", reference="delta_state").decode(np.array([[0, 0, 0, 0.5, -0.1, 0.2, 1.0]]), state)
    found = Rotation.from_quat(step["ee_pose"][3:], scalar_first=True).as_euler("xyz")
    assert found == pytest.approx([0.6, 0.1, 0.5], abs=1e-6)


def test_in_the_moving_frame_steps_that_add_up_turn_with_it() -> None:
    parts: list[Any] = [
        {"position": {"arm": "single", "applied": "body"}},
        {"rotation": {"arm": "single", "form": "axis_angle", "applied": "body"}},
        GRIPPER,
    ]
    raw = np.array([[0.1, 0, 0, 0, 0, np.pi / 2, 1.0]] * 2)
    for reference, places in (
        ("cumulative", [[0.5, 0, 0.3], [0.5, 0.1, 0.3]]),
        ("delta_command", [[0.5, 0, 0.3], [0.5, 0.1, 0.3]]),
        ("delta_state", [[0.5, 0, 0.3], [0.5, 0, 0.3]]),
    ):
        steps = _action(parts, "ee", reference=reference).decode(raw, STATE)
        assert [step["ee_pose"][:3].tolist() for step in steps] == [pytest.approx(place, abs=1e-6) for place in places]


def test_points_and_frames() -> None:
    """The fingertips lie 0.1034 m before a Franka's flange; its base is turned by a quarter and stands at 0.765 m."""
    pose = np.array([0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0])  # the hand looks down
    obs = observation("franka")
    obs["state"]["left_ee_pose"] = pose
    block: Any = {
        "state": [
            {"input": "tcp", "parts": [{"position": {"arm": "left", "point": "tcp"}}]},
            {"input": "base", "parts": [{"position": {"arm": "left", "frame": "base"}}]},
        ],
        "action": {"reference": "absolute", "parts": []},
    }
    parts: list[Any] = [{"joints": {"arm": arm}} for arm in ("left", "right")]
    parts += [{"gripper": {"arm": arm, "closed": 0, "open": 1}} for arm in ("left", "right")]
    block["action"]["parts"] = parts
    inputs = compile_interface(block, get_embodiment("franka"), "joint").encode(obs)
    assert inputs["tcp"] == pytest.approx([0, 0, 1 - 0.1034], abs=1e-6)
    # The base's x is the world's y: the flange stands 0.3 to the right of it and 0.55 before it.
    assert inputs["base"] == pytest.approx([0.55, -0.3, 0.235], abs=1e-6)


def test_position_and_rotation_may_be_of_different_points() -> None:
    """As robosuite, which gives where the fingertips are, and how the hand is turned."""
    parts: list[Any] = [
        {"position": {"arm": "single", "point": "tcp"}},
        {"rotation": {"arm": "single", "point": "flange", "form": "quaternion_xyzw"}},
        GRIPPER,
    ]
    down = np.array([0.0, 1.0, 0.0, 0.0])
    (step,) = _action(parts, "ee").decode(np.array([[0.4, 0.1, 0.2, 1.0, 0.0, 0.0, 0.0, 1.0]]), STATE)
    assert step["ee_pose"][:3] == pytest.approx([0.4, 0.1, 0.3034], abs=1e-6)
    assert np.abs(step["ee_pose"][3:]) == pytest.approx(down, abs=1e-6)


def test_what_no_part_says_of_a_pose_stays() -> None:
    parts: list[Any] = [
        {"rotation": {"arm": "single", "point": "tcp", "form": "axis_angle", "applied": "body"}},
        GRIPPER,
    ]
    action = _action(parts, "ee", reference="delta_state")
    (step,) = action.decode(np.array([[np.pi, 0, 0, 1.0]]), STATE)
    assert step["ee_pose"][:3] == pytest.approx([0.4, 0, 0.3 + 2 * 0.1034], abs=1e-6)
    (step,) = _action([{"position": {"arm": "single"}}, GRIPPER], "ee").decode(np.array([[0.1, 0.2, 0.3, 1.0]]), STATE)
    assert step["ee_pose"] == pytest.approx([0.1, 0.2, 0.3, 1, 0, 0, 0])


def test_units_of_lengths() -> None:
    for unit, factor in (("m", 1), ("cm", 100), ("mm", 1000)):
        action = _action([{"position": {"arm": "single", "unit": unit}}, GRIPPER], "ee", reference="delta_state")
        (step,) = action.decode(np.array([[0.1 * factor, 0, 0, 1.0]]), STATE)
        assert step["ee_pose"][0] == pytest.approx(0.5)


def test_padding_means_nothing() -> None:
    action = _action([JOINTS, {"fill": {"width": 2}}, GRIPPER], pad=32)
    raw = np.full((1, 32), np.nan)
    raw[0, :10] = [*HOME, 9.0, 9.0, 1.0]
    (step,) = action.decode(raw, STATE)
    assert step["arm_joint_state"] == pytest.approx(HOME)
    again = action.encode([step], STATE)
    assert again.shape == (1, 32)
    assert (again[0, [7, 8, *range(10, 32)]] == 0).all()
