"""What the experiments of the offline gate are made of: changed observations, limits, rotations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl import _spec as sdk
from xpl import image_codec
from xpl.action import pack, unpack
from xpl.embodiment import get_embodiment
from xpl.observation import ObservationError, get_image, get_instruction, pack_state
from xpl_cli.audit.engine import engine
from xpl_cli.audit.offline import faulty_inputs, limits, rotations
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.served import transports
from xpl_cli.packages import environments
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers

if TYPE_CHECKING:
    from pathlib import Path

ROBOT = get_embodiment("arx_x5")
SCENARIO = environments.module("offline", "scenario")
RATE = SCENARIO.FREQUENCY


@pytest.fixture
def obs() -> dict[str, Any]:
    """A scripted observation of two arms."""
    made: dict[str, Any] = SCENARIO.observation(ROBOT)
    return made


@pytest.mark.parametrize("form", transports.FORMS)
def test_every_form_of_a_picture_is_read_as_rgb(obs: dict[str, Any], form: str) -> None:
    """PNG exactly, JPEG within its error, which is far from exchanged colours; the original stays as it was."""
    sent = transports.encoded(obs, form)
    for camera in sent[sdk.Obs.VISION].values():
        color = camera[sdk.Camera.COLOR]
        assert isinstance(color, bytes)
        assert image_codec.has_marker(color) == (form == "marked JPEG")
    read = transports.decoded(sent)
    error = transports.error_of(obs, read)
    assert error == 0 if form == "true-RGB PNG" else 0 < error < 40
    exchanged = {**read[sdk.Obs.VISION]["cam_head"]}
    exchanged[sdk.Camera.COLOR] = exchanged[sdk.Camera.COLOR][:, :, ::-1]
    wrong = {**read, sdk.Obs.VISION: {**read[sdk.Obs.VISION], "cam_head": exchanged}}
    assert transports.error_of(obs, wrong) > 100
    assert isinstance(obs[sdk.Obs.VISION]["cam_head"][sdk.Camera.COLOR], np.ndarray)


def read(obs: dict[str, Any], name: str) -> None:
    """Read one input the way that the SDK offers."""
    group, _, leaf = name.partition(".")
    if group == "vision":
        get_image(obs, leaf)
    elif group == "state":
        pack_state(obs, ROBOT, "ee" if leaf == "ee_pose" else "joint")
    elif get_instruction(obs) is None:
        raise ObservationError("no instruction")


@pytest.mark.parametrize(
    "name", ["instruction", "vision.cam_head", "state.arm_joint_state", "state.ee_joint_state", "state.ee_pose"]
)
def test_the_readers_of_the_sdk_refuse_every_fault_by_name(obs: dict[str, Any], name: str) -> None:
    """An adapter that reads with them has a clear error for each case that the audit tries."""
    cases = [*faulty_inputs.missing(obs, name), *faulty_inputs.damaged(obs, name)]
    assert len({case.fault for case in cases}) == len(cases) > 1
    for case in cases:
        with pytest.raises(ObservationError) as raised:
            read(case.obs, name)
        assert any(word in str(raised.value) for word in case.names), (case.fault, str(raised.value))


def moved(by: float, column: int, action_type: str = "joint") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a state and the action that is off by so much in one column."""
    state = SCENARIO.observation(ROBOT)["state"]
    flat = pack(state, ROBOT, action_type)
    flat[column] += by
    return state, unpack(flat, ROBOT, action_type)


def test_a_jump_is_more_than_the_robot_moves_in_one_step() -> None:
    """By the speed of the joint: 5 rad/s at 25 Hz are 0.2 rad. The gripper may jump."""
    assert not list(limits.jumps(ROBOT, *moved(0.19, 0), RATE))
    (excesses,) = limits.jumps(ROBOT, *moved(0.25, 0), RATE)
    assert str(excesses) == "left_arm_joint_state[0]: 0.25 rad, possible are 0.201"
    assert not list(limits.jumps(ROBOT, *moved(0.3, 6), RATE))
    assert not list(limits.jumps(ROBOT, *moved(0.25, 0), RATE / 2))


def test_a_jump_of_a_pose_is_one_of_position_or_orientation() -> None:
    (excesses,) = limits.jumps(ROBOT, *moved(-0.2, 9, "ee"), RATE)
    assert excesses.what == "position of right_ee_pose"
    state, action = moved(0, 0, "ee")
    action["left_ee_pose"][3:] *= -1
    assert not list(limits.jumps(ROBOT, state, action, RATE))
    action["left_ee_pose"][3:] = rotations.LARGE
    assert [excesses.what for excesses in limits.jumps(ROBOT, state, action, RATE)] == ["orientation of left_ee_pose"]


def test_joints_end_where_the_embodiment_says() -> None:
    """At either end; where no limits are known there is nothing to say."""
    _, action = moved(10.0, 1)
    assert [excess.what for excess in limits.outside(ROBOT, action)] == ["left_arm_joint_state[1]"]
    _, action = moved(-10.0, 1)
    assert [excess.limit for excess in limits.outside(ROBOT, action)] == [ROBOT.arms[0].lower[1]]  # type: ignore[index]
    unknown = get_embodiment("tianji_marvin_wuji")
    assert unknown.arms[0].lower is None
    assert not list(limits.outside(unknown, {"left_arm_joint_state": np.full(7, 99.0)}))


def test_motions_differ_by_more_than_the_sign_of_a_quaternion() -> None:
    _, step = moved(0, 0, "ee")
    other = {key: np.array(values) for key, values in step.items()}
    other["right_ee_pose"][3:] *= -1
    assert rotations.rotation_difference([step], [other]) is None
    other["right_ee_pose"][3:] = rotations.LARGE
    assert "right_ee_pose" in str(rotations.rotation_difference([step], [other]))
    assert rotations.rotation_difference([step], [step, step]) is not None


DRAWS = """
    def predict(self, inputs, envs):
        rows = np.stack([row * (1 + 1e-3 * {draw}) for row, env in zip(inputs, envs)])
        return np.repeat(rows[:, None], self.chunk, axis=1)
"""
RULES = ("inputs-matter", "undeclared-input", "observation-forms")


@pytest.mark.slow
@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("draw", "deterministic", "outcomes"),
    [
        ("self.rng(env).uniform()", True, {Outcome.PASS}),
        ("__import__('random').random()", False, {Outcome.PASS, Outcome.NOT_APPLICABLE}),
    ],
    ids=["seeded by the episode", "not deterministic"],
)
def test_policies_that_draw_random_numbers_are_not_blamed(
    tmp_path: Path, draw: str, deterministic: bool, outcomes: set[Outcome]
) -> None:
    """Both episodes of a pair draw the same numbers; of a policy that does not repeat itself only errors count."""
    folder = tmp_path / "Subject"
    adapter.write(adapter.render(AdapterAnswers(**{**adapter.defaults(), "name": "Subject", "block": False})), folder)
    manifest = folder / "policy.yml"
    told = f"deterministic: {str(deterministic).lower()}"
    manifest.write_text(manifest.read_text().replace("deterministic: true", told))
    with (folder / "model.py").open("a") as stream:
        stream.write(DRAWS.format(draw=draw))
    (gate,) = engine.audit(folder, "policy", AuditOptions(gates=(Gate.OFFLINE,), names=RULES)).gates
    assert {result.outcome for result in gate.results} <= outcomes, gate.results
