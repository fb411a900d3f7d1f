"""Scaffolds: a native block, load and predict; code where that is wished; a reference to compare with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from tests.support.adapters.native import observation
from tests.support.peer import xpl
from xpl import get_embodiment
from xpl.action import check_chunk
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import Options
from xpl_cli.basics import content
from xpl_cli.scaffold import adapter as scaffold
from xpl_cli.standard.validate import validate_yaml_file

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.scaffold.answers import Answers

VARIANTS: dict[str, dict[str, Any]] = {
    "block": {},
    "block, cameras and history": {"cameras": ("cam_head:32x24", "cam_left_wrist"), "history": 3},
    "code": {"block": False},
    "code, cameras": {"block": False, "cameras": ("cam_head",)},
    "code, history": {"block": False, "history": 2},
    "code, cameras and history": {"block": False, "cameras": ("cam_head",), "history": 2},
    "reference": {"native_reference": True, "cameras": ("cam_head",), "history": 2},
    "reference to code": {"native_reference": True, "block": False},
    "torch": {"kind": "torch", "cameras": ("cam_head",), "history": 2},
    "torch, code": {"kind": "torch", "cameras": ("cam_head",), "block": False},
    "lerobot": {"kind": "lerobot", "native_reference": True},
    "remote": {"kind": "remote"},
}
TOLD = {"placeholders", "native-sources"}
"""Rules that a fresh scaffold does not satisfy, on purpose: its author has not filled it in yet."""


def _answers(**chosen: Any) -> Answers:
    answers = scaffold.answers_of(**{"name": "Foo", **scaffold.defaults(), **chosen})
    scaffold.check(answers)
    return answers


def _written(folder: Path, **chosen: Any) -> Path:
    scaffold.write(scaffold.render(_answers(**chosen)), folder)
    return folder


def _model(folder: Path) -> Any:
    config, manifest = (yaml.safe_load((folder / name).read_text()) for name in ("deploy.yml", "policy.yml"))
    return content.load_module(folder / "model.py").Model({**config, "manifest": manifest})


@pytest.mark.sampled(3)
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_scaffold_is_valid_and_has_no_static_finding(variant: str, tmp_path: Path) -> None:
    folder = _written(tmp_path / "Foo", **VARIANTS[variant])
    assert validate_yaml_file(folder / "policy.yml", "policy") == []
    (gate,) = engine.audit(folder, "policy", Options(gates=(Gate.STATIC,))).gates
    found = {result.slug: result for result in gate.results if result.findings or result.outcome == "error"}
    has_reference = VARIANTS[variant].get("native_reference", False)
    assert set(found) == (TOLD if has_reference else {"placeholders"}), found
    assert (folder / "native.py").exists() == has_reference
    if has_reference:
        (finding,) = found["native-sources"].findings
        assert "conventions are assumed" in finding.message


@pytest.mark.sampled(10)
@pytest.mark.parametrize("action_type", ["joint", "ee"])
@pytest.mark.parametrize("robot", ["arx_x5", "franka_single", "tianji_marvin_wuji"])
@pytest.mark.parametrize("variant", [name for name, chosen in VARIANTS.items() if "kind" not in chosen])
def test_a_fresh_scaffold_holds_the_pose(variant: str, robot: str, action_type: str, tmp_path: Path) -> None:
    cameras = ("cam_head",) if "cameras" in VARIANTS[variant] else ()
    chosen = {**VARIANTS[variant], "cameras": cameras, "embodiment": robot, "action_type": action_type, "chunk": 3}
    folder = _written(tmp_path / "Foo", **chosen)
    model = _model(folder)
    assert (model.interface is None) == (not chosen.get("block", True))
    seen = [observation(robot, seed) for seed in range(2)]
    for obs in seen:
        model.update_obs(obs)
        chunk = model.get_action()
        check_chunk(chunk, get_embodiment(robot), action_type)
        assert len(chunk) == 3
        for key, value in chunk[-1].items():
            np.testing.assert_allclose(value, obs["state"][key], atol=1e-6)
    if chosen.get("native_reference"):
        answer = content.load_module(folder / "native.py").answers({})
        told = answer(_Episode(seen))
        assert len(told) == 3
        for key, value in chunk[-1].items():
            np.testing.assert_allclose(told[-1][key], value, atol=1e-6)


class _Episode:
    def __init__(self, observations: list[dict[str, Any]]) -> None:
        self.observations = observations
        self.asked = list(range(len(observations)))


def test_an_adapter_with_a_block_writes_load_and_predict_alone(tmp_path: Path) -> None:
    for kind in ("minimal", "torch"):
        folder = _written(tmp_path / kind, name=kind, kind=kind)
        methods = [
            line.split("(")[0].split()[1] for line in (folder / "model.py").read_text().splitlines() if "def " in line
        ]
        assert methods == ["load", "predict"]


def test_all_options_that_do_not_fit_are_told_at_once(tmp_path: Path) -> None:
    wrong = ["--chunk", "0", "--history", "0", "--action-type", "joints", "--cameras", "cam_haed", "--python", "three"]
    done = xpl("new-policy", "class", *wrong, "--kind", "tourch", cwd=tmp_path)
    assert (done.returncode, done.stdout, list(tmp_path.iterdir())) == (2, "", [])
    for told in (
        "'class' cannot name",
        "--chunk must",
        "--history must",
        "one of joint, ee",
        "cam_head",
        "--python takes",
    ):
        assert told in done.stderr
    assert "did you mean torch?" in done.stderr
