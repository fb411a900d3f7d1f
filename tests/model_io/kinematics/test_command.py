"""`xpl model-io kinematics` prints a sentence for each part, and ends by what it found."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from tests.support.peer import xpl
from tests.support.recordings.arms import moments, rows
from xpl import get_embodiment
from xpl.manifest import Manifest
from xpl_cli.basics.errors import ExitCode
from xpl_cli.model_io.kinematics import sample_verdicts
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.standard import answers

if TYPE_CHECKING:
    from pathlib import Path

ROBOT = "franka_single"


def _made(folder: Path, form: str, *, samples: bool = True, **changes: Any) -> Path:
    """Write an adapter whose authors' data have quaternions [x, y, z, w]."""
    given = {**adapter.defaults(), "name": folder.name, "embodiment": ROBOT, "action_type": "ee"}
    adapter.write(adapter.render(AdapterAnswers(**given)), folder)
    manifest = yaml.safe_load((folder / "policy.yml").read_text(encoding="utf-8"))
    joints, single = [{"joints": {"arm": "single"}}], {"arm": "single"}
    pose = [{"position": single}, {"rotation": {**single, "form": form}}]
    manifest.update(spec="v1", **changes)
    manifest["model_io"] = {
        "state": [{"input": "pose", "parts": pose}],
        "action": {"reference": "absolute", "parts": [*pose, {"gripper": {**single, "closed": 0.0, "open": 1.0}}]},
        "samples": [
            {"file": "rows.npz", "key": "pose", "of": "pose"},
            {"file": "rows.npz", "key": "joints", "parts": joints},
        ]
        if samples
        else [],
    }
    (folder / "policy.yml").write_text(yaml.safe_dump(manifest), encoding="utf-8")
    states = moments(get_embodiment(ROBOT), np.random.default_rng(0), 20)
    written = [{"position": single}, {"rotation": {**single, "form": "quaternion_xyzw"}}]
    np.savez(folder / "rows.npz", pose=rows(written, ROBOT, states), joints=rows(joints, ROBOT, states))
    return folder


def test_a_contradiction_is_a_finding(tmp_path: Path) -> None:
    folder = _made(tmp_path / "P", "quaternion_wxyz")
    done = xpl("model-io", "kinematics", str(folder), "--json", cwd=tmp_path)
    assert done.returncode == ExitCode.FINDINGS, done.stderr
    told = json.loads(done.stdout)
    assert answers.problems(told) == []
    assert [verdict["outcome"] for verdict in told["verdicts"]] == ["agrees", "agrees", "differs"]
    assert told["verdicts"][2]["best"] == {"form": "quaternion_xyzw"}


def test_what_agrees_is_clean(tmp_path: Path) -> None:
    done = xpl("model-io", "kinematics", str(_made(tmp_path / "P", "quaternion_xyzw")), cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert done.stdout.count("agrees to 0") == 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"samples": False}, "names no samples"),
        ({"embodiments": ["fetch"]}, "has the joint frames of none of the declared robots"),
    ],
)
def test_without_a_witness_that_is_said(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    folder = _made(tmp_path / "P", "quaternion_wxyz", **changes)
    manifest = Manifest.parse(yaml.safe_load((folder / "policy.yml").read_text(encoding="utf-8")))
    with pytest.raises(sample_verdicts.NotJudgeableError, match=words):
        sample_verdicts.judge_samples(manifest, [folder])


def test_rows_are_of_the_robot_that_they_fit(tmp_path: Path) -> None:
    folder = _made(tmp_path / "P", "quaternion_xyzw", embodiments=["piper_single", ROBOT])
    manifest = Manifest.parse(yaml.safe_load((folder / "policy.yml").read_text(encoding="utf-8")))
    verdicts = sample_verdicts.judge_samples(manifest, [folder])
    assert {verdict.outcome for verdict in verdicts} == {"agrees"}
