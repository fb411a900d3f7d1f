"""State and action are told number by number: names, units, values, and the standard's beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters import model_io as support
from tests.support.adapters import two_arm_adapter
from xpl import get_embodiment
from xpl.convert import compile_interface
from xpl_cli.model_io import script
from xpl_cli.model_io.show import numbers, report, robot_figure, scene
from xpl_cli.model_io.show.compiled_adapter import load_adapter
from xpl_cli.packages import package

if TYPE_CHECKING:
    from pathlib import Path


def test_the_state_is_told_in_both_words(tmp_path: Path) -> None:
    what = load_adapter(package.load(two_arm_adapter.write_adapter(tmp_path / "P", two_arm_adapter.block())), {})
    listed = report.report_from_block(what, scene.scripted(what.package.manifest, what.robot, what.cameras, 1))
    (vector,) = listed.vectors
    first, gripper, padding = vector.numbers[0], vector.numbers[6], vector.numbers[-1]
    assert (first.part, first.name, first.unit) == ("joints left", "joint1", "deg")
    ((radians,),) = (entry["values"] for entry in first.standard)
    assert first.values["before"] == pytest.approx([np.rad2deg(radians)])
    assert first.values["model"] == pytest.approx([np.rad2deg(radians) / 200], abs=1e-6)
    assert gripper.says == "closed 0.0, open 0.044"
    assert gripper.standard[0]["name"] == "left_ee_joint_state[0] opening"
    assert (padding.part, padding.name) == ("padding", "2 numbers")
    assert vector.words == "normalised by min_max, padded to 16"
    assert listed.texts == {"prompt": "put the red block into the left tray.\n"}


def test_a_command_that_begins_by_holding_still_shows_what_deltas_are(tmp_path: Path) -> None:
    what = load_adapter(package.load(two_arm_adapter.write_adapter(tmp_path / "P", two_arm_adapter.block())), {})
    listed = report.report_from_block(what, scene.scripted(what.package.manifest, what.robot, what.cameras, 1))
    joint, gripper = listed.action[1], listed.action[6]
    before, after = (entry["values"] for entry in (joint.standard[0], {"values": joint.values["before"]}))
    assert after[0] == pytest.approx(0, abs=1e-4)
    assert after[1] == pytest.approx(np.rad2deg(before[1] - before[0]), abs=1e-3)
    assert joint.says.startswith("delta_state")
    assert gripper.says.startswith("absolute")
    assert gripper.values["before"][0] == pytest.approx(0.044 * gripper.standard[0]["values"][0], abs=1e-6)


@pytest.mark.parametrize("name", sorted(support.CASES))
def test_every_word_of_the_block_has_a_table_and_a_figure(name: str) -> None:
    case = support.CASES[name]
    interface = compile_interface(case.model_io, case.embodiment, case.action_type)
    observation = support.observation(case.robot)
    inputs = interface.encode(observation, {})
    read = []
    for entry in case.model_io.get("state", ()):
        vector = interface.states[entry["input"]]
        values = np.asarray(inputs[entry["input"]])
        listed = numbers.of_state(entry, vector, values, observation["state"], case.embodiment)
        assert len(listed) == vector.width + (vector.padded > vector.width)
        assert all(one.name for one in listed)
        read.append(
            robot_figure.ReadVector(entry["input"], entry, vector, vector.denormalize(values.astype(np.float64)))
        )
    steps = support.steps(case, np.random.default_rng(0), 4)
    answer = interface.action.encode(steps, observation["state"], {})
    listed = numbers.of_action(case.model_io["action"], interface, answer, steps, case.embodiment)
    assert len(listed) == interface.action.vector.width + (
        interface.action.vector.padded > interface.action.vector.width
    )
    drawn = robot_figure.figures(case.embodiment, observation["state"], read, steps)
    assert len({figure.label for figure in drawn}) == 3
    for figure in drawn:
        assert "nan" not in figure.svg()


def test_a_pose_is_drawn_where_its_words_say() -> None:
    body = get_embodiment("franka_single")
    parts: list[dict[str, Any]] = [
        {"position": {"arm": "single", "point": "tcp", "frame": "base", "unit": "mm"}},
        {"rotation": {"arm": "single", "point": "tcp", "frame": "base", "form": "rot6d_rows"}},
    ]
    model_io = {
        "state": [{"input": "s", "parts": parts}],
        "action": {"reference": "absolute", "parts": [*parts, FINGER]},
    }
    interface = compile_interface(model_io, body, "ee")
    observation = script.ScriptedScene(body, {}).observation(0, 1)
    values = interface.encode(observation)["s"].astype(np.float64)
    (mark,) = robot_figure._marks(
        body, robot_figure.ReadVector("s", model_io["state"][0], interface.states["s"], values), observation["state"]
    )
    assert mark.pose[:3] == pytest.approx(observation["state"]["tcp_pose"][:3], abs=1e-5)
    assert abs(mark.pose[3:] @ observation["state"]["tcp_pose"][3:]) == pytest.approx(1, abs=1e-5)
    assert mark.label == "s: single tcp in the base"


FINGER = {"gripper": {"arm": "single", "closed": 0.0, "open": 1.0}}
