"""LeRobot's own SO-101 and a plugin of it, in LeRobot's Python: the servos are ours, at the other end of a serial line.

`XPL_LEROBOT_PYTHON` names a Python that has LeRobot 0.4 and feetech-servo-sdk, as CONTRIBUTING.md tells. Without it
this is not run.
"""

from __future__ import annotations

import json
import os
import subprocess
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.arms.servo_bus import GOAL, TORQUE, servos
from tests.support.checkout import ROOT
from xpl import get_embodiment

PYTHON = os.environ.get("XPL_LEROBOT_PYTHON", "")
DRIVER = Path(__file__).with_name("lerobot_arm.py")
ARM = get_embodiment("so101")
RANGE, MIDDLE, TURN = (1024, 3072), 2048, 4095
"""Ticks between which a servo turns, the one in the middle, and those of a whole turn."""
COMMAND = {"arm_joint_state": [0.1, -0.2, 0.3, 0.0, -0.4], "ee_joint_state": [0.25]}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON, reason="not run: XPL_LEROBOT_PYTHON names no Python that has LeRobot"),
]


def drive(kind: str, settings: dict[str, Any], folder: Path) -> Any:
    """Return what a robot of LeRobot said before a command and after it, or why it was refused."""
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)])}
    wish = json.dumps({"type": kind, "settings": settings, "command": COMMAND})
    command = [PYTHON, str(DRIVER)]
    done = subprocess.run(command, input=wish, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.fixture
def calibration(tmp_path: Path) -> dict[str, Any]:
    """Settings of an arm whose calibration is that of its servos."""
    names = [*(ARM.arms[0].joint_names or ()), "gripper"]
    motors = {
        name: {"id": number, "drive_mode": 0, "homing_offset": 0, "range_min": RANGE[0], "range_max": RANGE[1]}
        for number, name in enumerate(names, 1)
    }
    (tmp_path / "cell.json").write_text(json.dumps(motors), encoding="utf-8")
    return {"id": "cell", "calibration_dir": str(tmp_path)}


def test_an_so101_is_read_and_commanded(calibration: dict[str, Any], tmp_path: Path) -> None:
    """Servos get the ticks that the angles are, the gripper its share; torque stays on when it is let go."""
    with servos(RANGE) as bus:
        before, after = drive("so101_follower", {"port": bus.port, **calibration}, tmp_path)
        goals = [bus.number(servo, GOAL) for servo in range(1, 7)]
        assert all(bus.memories[servo][TORQUE] for servo in range(1, 7))
    angles = np.array(COMMAND["arm_joint_state"])
    assert goals[:5] == pytest.approx(MIDDLE + angles / (2 * np.pi) * TURN, abs=1)
    assert goals[5] == pytest.approx(RANGE[0] + 0.25 * (RANGE[1] - RANGE[0]), abs=1)
    assert before["arm_joint_state"] == pytest.approx([0.0] * 5, abs=1e-3)
    assert before["ee_joint_state"] == pytest.approx([0.5], abs=1e-3)
    assert after["arm_joint_state"] == pytest.approx(angles, abs=2e-3)
    assert after["ee_joint_state"] == pytest.approx([0.25], abs=1e-3)


def test_an_arm_that_counts_in_percent_is_refused(calibration: dict[str, Any], tmp_path: Path) -> None:
    """A hundredth of a range for a degree would be another pose."""
    with servos(RANGE) as bus:
        told = drive("so101_follower", {"port": bus.port, "use_degrees": False, **calibration}, tmp_path)
        assert not any(bus.number(servo, GOAL) for servo in range(1, 7))
    assert "use_degrees=True" in told["refused"]


def test_servos_with_another_calibration_are_not_moved(calibration: dict[str, Any], tmp_path: Path) -> None:
    """The zeros of their joints are elsewhere."""
    with servos((0, 4095)) as bus:
        told = drive("so101_follower", {"port": bus.port, **calibration}, tmp_path)
        assert not any(bus.number(servo, GOAL) for servo in range(1, 7))
    assert "lerobot-calibrate" in told["refused"]


def test_a_plugin_is_found_by_its_type(tmp_path: Path) -> None:
    """As LeRobot finds it: a distribution `lerobot_robot_*` that registers a configuration."""
    package = tmp_path / "lerobot_robot_cell"
    package.mkdir()
    (package / "__init__.py").write_text(textwrap.dedent(PLUGIN), encoding="utf-8")
    metadata = tmp_path / "lerobot_robot_cell-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: lerobot_robot_cell\nVersion: 1.0\n", encoding="utf-8"
    )
    before, after = drive("cell_arm", {"gain": 0.5, "calibration_dir": str(tmp_path)}, tmp_path)
    assert before["arm_joint_state"] == [0.0] * 5
    assert after["arm_joint_state"] == pytest.approx(np.array(COMMAND["arm_joint_state"]) / 2)


PLUGIN = """
    from dataclasses import dataclass

    from lerobot.robots import Robot, RobotConfig

    NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


    @RobotConfig.register_subclass("cell_arm")
    @dataclass
    class CellArmConfig(RobotConfig):
        gain: float = 1.0


    class CellArm(Robot):
        config_class = CellArmConfig
        name = "cell_arm"
        is_connected = False
        is_calibrated = True

        def __init__(self, config):
            super().__init__(config)
            self.config, self.at = config, dict.fromkeys((f"{name}.pos" for name in NAMES), 0.0)

        @property
        def observation_features(self):
            return dict.fromkeys(self.at, float)

        action_features = observation_features

        def connect(self, calibrate=True):
            assert not calibrate
            self.is_connected = True

        def calibrate(self):
            raise AssertionError

        def configure(self):
            pass

        def get_observation(self):
            return dict(self.at)

        def send_action(self, action):
            self.at = {name: value * self.config.gain for name, value in action.items()}
            return self.at

        def disconnect(self):
            self.is_connected = False
"""
