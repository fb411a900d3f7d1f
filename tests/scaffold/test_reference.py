"""reference.py to fill in: all that the manifest says in the standard's words, and nothing of the model."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from tests.support.adapters import parity
from tests.support.peer import xpl
from xpl.manifest import Manifest
from xpl_cli.basics.errors import ExitCode
from xpl_cli.model_io import reference_file
from xpl_cli.packages.conventions import applicable_conventions
from xpl_cli.scaffold import reference
from xpl_cli.standard import answers

if TYPE_CHECKING:
    from pathlib import Path

MODELS_SIDE = ("bgr", "delta_state", "nearest", "min_max", "0.04", "Task:")
"""What the block below says of the model."""


def _manifest(**changes: Any) -> Manifest:
    return Manifest.parse(parity.manifest("Foo", parity.block(), **changes))


def test_it_has_the_conventions_of_the_block_each_without_a_source() -> None:
    read = reference_file.parse(reference.text(_manifest()))
    assert sorted(read.conventions) == applicable_conventions(_manifest())
    assert read.empty == tuple(read.conventions)
    assert read.defines_answers


def test_it_reads_what_the_policy_reads_and_says_nothing_of_the_model() -> None:
    text = reference.text(_manifest())
    assert 'state = episode.observations[-1]["state"]  # arm_joint_state (7,), ee_joint_state (1,)\n' in text
    assert 'cam_head = episode.observations[-1]["vision"]["cam_head"]["color"]  # (H, W, 3) uint8 RGB\n' in text
    assert 'instruction = episode.observations[-1].get("instruction", "")' in text
    assert 'numbers = {"arm_joint_state": 7, "ee_joint_state": 1}' in text
    assert "cam_wrist" not in text
    assert [word for word in MODELS_SIDE if word in text] == []


def test_two_arms_are_told_by_their_prefixes() -> None:
    text = reference.text(_manifest(embodiments=["arx_x5"]))
    assert "# arm_joint_state (6,), ee_joint_state (1,), each with left_ and right_\n" in text
    assert '"left_arm_joint_state": 6, "left_ee_joint_state": 1, "right_arm_joint_state": 6' in text


def test_a_model_of_one_page_has_one_of_thirty_lines() -> None:
    """With fourteen conventions; three lines of the authors' code take the place of three that are written."""
    assert len(reference.text(_manifest()).splitlines()) <= 30


def test_the_command_writes_it_once_and_it_can_be_recorded(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo", code=None)
    missing = xpl("model-io", "record", str(folder), cwd=tmp_path)
    assert missing.returncode == ExitCode.NOT_FOUND
    assert f"xpl model-io reference {folder}" in missing.stderr
    completed = xpl("model-io", "reference", "Foo", "--json", cwd=tmp_path)
    assert completed.returncode == ExitCode.CLEAN, completed.stderr
    answer = json.loads(completed.stdout)
    assert answers.problems(answer) == []
    assert answer["next"] == ["xpl model-io record Foo"]
    assert (folder / "reference.py").read_text() == reference.text(_manifest())
    assert xpl("model-io", "record", "Foo", cwd=tmp_path).returncode == ExitCode.CLEAN
    again = xpl("model-io", "reference", "Foo", cwd=tmp_path)
    assert again.returncode == ExitCode.USAGE
    assert "is there already" in again.stderr


def test_a_manifest_of_an_unknown_robot_is_refused(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo", code=None, embodiments=["nobody"])
    completed = xpl("model-io", "reference", "Foo", cwd=tmp_path)
    assert completed.returncode == ExitCode.USAGE
    assert "policy.yml: " in completed.stderr
    assert not (folder / "reference.py").exists()
