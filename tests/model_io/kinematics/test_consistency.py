"""Kinematics finds how joints and poses are written, and says when it cannot tell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.recordings.arms import ROBOTS, moments, rows
from xpl import get_embodiment
from xpl.conventions import rotation as rotations
from xpl.conventions.rotation import ORDERS
from xpl_cli.model_io.kinematics import consistency
from xpl_cli.model_io.kinematics.consistency import AGREES, DIFFERS, OPEN, UNEXPLAINED, KinematicsVerdict
from xpl_cli.model_io.kinematics.samples import SampleColumns

POINTS, FRAMES, UNITS = ("flange", "tcp"), ("world", "base"), ("m", "cm", "mm")
FORMS = [{"form": form} for form in rotations.WIDTHS if form != "euler"] + [
    {"form": "euler", "euler": order} for order in ORDERS
]
PLACES = st.fixed_dictionaries({"point": st.sampled_from(POINTS), "frame": st.sampled_from(FRAMES)})


def _same_width(form: dict[str, str]) -> list[dict[str, str]]:
    width = rotations.WIDTHS[form["form"]]
    return [other for other in FORMS if rotations.WIDTHS[other["form"]] == width]


def _judged(
    robot: str,
    states: list[dict[str, np.ndarray]],
    true: dict[str, dict[str, Any]],
    declared: dict[str, dict[str, Any]],
    noise: float = 0.0,
) -> dict[str, KinematicsVerdict]:
    """Return the verdict on each kind of part of the first arm; data are written in one way and declared in another."""
    side = next(iter(get_embodiment(robot).data["arms"]))
    rng = np.random.default_rng(1)
    columns = []
    for kind, words in true.items():
        numbers = rows([{kind: {"arm": side, **words}}], robot, states)
        scale = noise * (UNIT_OF.get(words.get("unit", "m"), 1.0) if kind == "position" else 1.0)
        numbers = numbers + scale * rng.normal(size=numbers.shape)
        columns.append(SampleColumns(kind, kind, {"arm": side, **declared[kind]}, numbers))
    return {verdict.kind: verdict for verdict in consistency.judge(columns, get_embodiment(robot))}


UNIT_OF = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


def _finds(verdict: KinematicsVerdict, true: dict[str, Any]) -> bool:
    """Tell whether a verdict's words are the true ones, or leaves these open."""
    said = {**verdict.declared, **verdict.best}
    return all(said.get(key) == value or value in verdict.open.get(key, ()) for key, value in true.items())


@settings(max_examples=8, deadline=None)
@given(data=st.data())
def test_the_words_are_found_from_twenty_rows_whatever_is_declared(data: Any) -> None:
    robot, form = data.draw(st.sampled_from(ROBOTS)), data.draw(st.sampled_from(FORMS))
    states = moments(get_embodiment(robot), np.random.default_rng(data.draw(st.integers(0, 2**32 - 1))), 20)
    true = {
        "joints": {},
        "position": {**data.draw(PLACES), "unit": data.draw(st.sampled_from(UNITS))},
        "rotation": {**data.draw(PLACES), **form},
    }
    said = {
        "joints": {},
        "position": {**data.draw(PLACES), "unit": data.draw(st.sampled_from(UNITS))},
        "rotation": {**data.draw(PLACES), **data.draw(st.sampled_from(_same_width(form)))},
    }
    found = _judged(robot, states, true, said)
    assert found["joints"].outcome == AGREES
    for kind in ("position", "rotation"):
        verdict = found[kind]
        assert _finds(verdict, true[kind]), verdict
        if verdict.outcome == DIFFERS:
            assert said[kind] != true[kind]
            assert verdict.best_error is not None
            assert verdict.declared_error is not None
            assert verdict.best_error < verdict.declared_error / 3
        else:
            assert verdict.outcome == AGREES
            assert said[kind] == true[kind] or verdict.open, verdict


@pytest.mark.parametrize("robot", ROBOTS)
def test_what_is_declared_right_agrees_with_calibration_errors(robot: str) -> None:
    states = moments(get_embodiment(robot), np.random.default_rng(3), 40)
    words: dict[str, dict[str, Any]] = {
        "joints": {},
        "position": {"point": "tcp", "frame": "base"},
        "rotation": {"form": "axis_angle", "point": "tcp", "frame": "base"},
    }
    found = _judged(robot, states, words, words, noise=0.002)
    assert {verdict.outcome for verdict in found.values()} == {AGREES}


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ({"unit": "deg"}, "unit: deg"),
        ({"sign": [1, 1, -1, 1, 1, 1]}, "sign of joint3"),
        ({"sign": [-1] * 6}, "sign of all joints"),
        (
            {"names": ["joint6", "joint5", "joint4", "joint3", "joint2", "joint1"]},
            "names in the reverse order",
        ),
        (
            {"names": ["joint2", "joint1", "joint3", "joint4", "joint5", "joint6"]},
            "names joint1 and joint2 exchanged",
        ),
    ],
)
def test_joints_in_another_unit_direction_or_order_are_found(words: dict[str, Any], change: str) -> None:
    pose = {"position": {"point": "tcp"}, "rotation": {"form": "quaternion_wxyz"}}
    states = moments(get_embodiment("piper_single"), np.random.default_rng(5), 20)
    found = _judged("piper_single", states, {"joints": words, **pose}, {"joints": {}, **pose})
    assert found["joints"].outcome == DIFFERS
    assert found["joints"].change == change
    assert {found[kind].outcome for kind in pose} == {AGREES}


def test_exchanged_arms_are_found() -> None:
    robot = get_embodiment("arx_x5")
    states = moments(robot, np.random.default_rng(8), 20)
    entries = [{"arm": "left"}, {"arm": "right"}]
    columns = [
        *(SampleColumns("j", "joints", entry, rows([{"joints": entry}], "arx_x5", states)) for entry in entries),
        SampleColumns("p", "position", entries[0], rows([{"position": entries[1]}], "arx_x5", states)),
    ]
    joints, position = (verdict for verdict in consistency.judge(columns, robot) if verdict.arm == "left")
    assert joints.best == {"joints": "arm: right"}
    assert position.best == {"arm": "right"}


def test_one_pose_tells_nothing() -> None:
    states = moments(get_embodiment("arx_x5"), np.random.default_rng(2), 30, spread=0.0)
    words: dict[str, dict[str, Any]] = {"joints": {}, "position": {}, "rotation": {"form": "quaternion_wxyz"}}
    found = _judged("arx_x5", states, words, {**words, "rotation": {"form": "quaternion_xyzw"}})
    assert {verdict.outcome for verdict in found.values()} == {OPEN}
    assert "1 different poses" in found["rotation"].because


def test_what_rows_do_not_tell_is_left_open() -> None:
    """The tool of this robot is not turned, so that rotations alone are the same at both points."""
    robot = "arx_x5_single"
    states = moments(get_embodiment(robot), np.random.default_rng(2), 20)
    words: dict[str, dict[str, Any]] = {"joints": {}, "rotation": {"form": "quaternion_wxyz", "point": "flange"}}
    verdict = _judged(robot, states, words, words)["rotation"]
    assert verdict.outcome == AGREES
    assert verdict.open == {"point": ["flange", "tcp"]}
    assert "do not tell point flange or tcp" in verdict.sentence


def test_degrees_of_euler_angles_are_told_although_the_block_has_no_word() -> None:
    states = moments(get_embodiment("piper_single"), np.random.default_rng(4), 20)
    entry = {"arm": "single", "form": "euler", "euler": "xyz"}
    joints = rows([{"joints": {"arm": "single"}}], "piper_single", states)
    turns = np.rad2deg(rows([{"rotation": entry}], "piper_single", states))
    columns = [SampleColumns("j", "joints", {"arm": "single"}, joints), SampleColumns("r", "rotation", entry, turns)]
    verdict = consistency.judge(columns, get_embodiment("piper_single"))[1]
    assert verdict.best == {"unit": "degrees (no word of the block)"}


def test_another_tool_and_another_frame_are_told_as_what_is_left_over() -> None:
    """A fixed shift or turn that the standard does not know: no words explain it, and the form is told even so."""
    robot = get_embodiment("franka_single")
    states = moments(robot, np.random.default_rng(9), 30)
    single = {"arm": "single"}
    joints = rows([{"joints": single}], "franka_single", states)
    place = rows([{"position": single}], "franka_single", states) + np.array([1.0, 2.0, 0.5])
    turn = rows([{"rotation": {**single, "form": "matrix"}}], "franka_single", states).reshape(-1, 3, 3)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    entry = {**single, "form": "rot6d_rows"}
    tool = (turn @ quarter)[:, :, :2].transpose(0, 2, 1).reshape(-1, 6)  # by columns
    columns = [
        SampleColumns("j", "joints", single, joints),
        SampleColumns("p", "position", single, place),
        SampleColumns("r", "rotation", entry, tool),
    ]
    _, position, rotation = consistency.judge(columns, robot)
    assert position.outcome == rotation.outcome == UNEXPLAINED
    assert "shifted by [1.000, 2.000, 0.500] m they agree to 0.0 mm" in position.because
    assert "form: rot6d_columns and the flange turned by 90.0 degrees about [0.00, 0.00, 1.00]" in rotation.because


def test_commands_lead_what_is_measured_and_are_judged_by_their_words_only() -> None:
    """A hand's breadth away they are still written in metres; a lead explains nothing else."""
    robot = get_embodiment("arx_x5")
    states = moments(robot, np.random.default_rng(6), 20)
    left = {"arm": "left"}
    ahead = np.array([0.05, 0.0, 0.02])
    joints = SampleColumns("j", "joints", left, rows([{"joints": left}], "arx_x5", states))
    wanted = rows([{"position": {**left, "unit": "mm"}}], "arx_x5", states) + 1000 * ahead
    command = SampleColumns("c", "position", {**left, "unit": "mm"}, wanted, leads=True)
    wrong = SampleColumns("c", "position", left, wanted, leads=True)
    assert consistency.judge([joints, command], robot)[1].outcome == OPEN
    assert consistency.judge([joints, wrong], robot)[1].best == {"unit": "mm"}
