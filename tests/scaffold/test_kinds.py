"""Kinds of adapters: each is valid and passes the gates that it can run; options that do not fit are refused."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.support.adapters.model_io import observation
from tests.support.checkout import ROOT
from tests.support.commands import Ended, xpl
from xpl import Client, get_embodiment
from xpl import _spec as sdk
from xpl.action import check_chunk
from xpl.client import PolicyServerError
from xpl.decoding import ensemble, within_limits
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics import content
from xpl_cli.basics.errors import UserError
from xpl_cli.scaffold import adapter as scaffold
from xpl_cli.scaffold import kinds, lock, update
from xpl_cli.serving.launch import running_server
from xpl_cli.standard.validate import validate_yaml_file

if TYPE_CHECKING:
    from xpl_cli.scaffold.answers import AdapterAnswers

PLACES = ("--workers", "4")
"""An audit starts the adapter more than once, and each time it is another client."""
ARM_JOINTS = sdk.State.ARM_JOINT_STATE
VARIANTS: dict[str, dict[str, Any]] = {
    "minimal": {},
    "ensembling": {"ensembling": 0.01},
    "cameras and history": {"cameras": ("cam_head:32x24", "cam_left_wrist"), "history": 3},
    "code": {"block": False},
    "code, cameras": {"block": False, "cameras": ("cam_head",)},
    "code, history": {"block": False, "history": 2},
    "code, cameras and history": {"block": False, "cameras": ("cam_head",), "history": 2},
    "reference": {"reference": True, "cameras": ("cam_head",), "history": 2},
    "reference to code": {"reference": True, "block": False},
    "torch": {
        "kind": "torch",
        "history": 2,
        "ensembling": 0.0,
        "cameras": ("cam_head:640x480", "cam_left_wrist"),
        "python": "3.11",
    },
    "torch, one arm": {
        "kind": "torch",
        "history": 3,
        "cameras": ("cam_wrist",),
        "embodiment": "franka_single",
        "action_type": "ee",
    },
    "torch, code": {"kind": "torch", "cameras": ("cam_head",), "block": False},
    "lerobot": {"kind": "lerobot", "history": 2, "cameras": ("cam_head:64x48", "cam_third_view")},
    "lerobot, reference": {"kind": "lerobot", "reference": True},
    "remote": {"kind": "remote"},
    "remote, everything": {
        "kind": "remote",
        "history": 2,
        "ensembling": 0.1,
        "cameras": ("cam_head",),
        "python": "3.11",
    },
}
ROBOTS = (("arx_x5", "joint"), ("franka_single", "ee"), ("tianji_marvin_wuji", "joint"))


def _answers(**chosen: Any) -> AdapterAnswers:
    answers = scaffold.answers_of(**{"name": "Foo", **scaffold.defaults(), **chosen})
    scaffold.check(answers)
    return answers


def _written(folder: Path, **chosen: Any) -> Path:
    scaffold.write(scaffold.render(_answers(name=folder.name, **chosen)), folder)
    return folder


def _bad(folder: Path, *gates: Gate, **options: Any) -> list[str]:
    """Audit an adapter; return what failed or crashed, and what warned besides the open places."""
    report = engine.audit(folder, "policy", AuditOptions(gates=gates, **options))
    assert [gate.name for gate in report.gates] == list(gates)
    return [
        f"{result.slug}: {result.findings or result.reason}"
        for gate in report.gates
        for result in gate.results
        if result.outcome in (Outcome.FAIL, Outcome.WARN, Outcome.ERROR, Outcome.NOT_RUN)
        and result.slug != "placeholders"
    ]


def _xpl(*arguments: str, cwd: Path) -> Ended:
    return xpl("new-policy", *arguments, folder=cwd)


# -- what is rendered --------------------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_scaffold_is_valid_says_what_was_chosen_and_is_rendered_again(variant: str, tmp_path: Path) -> None:
    """Open places, and conventions of a reference that are assumed, are all that the static gate finds."""
    folder, chosen = _written(tmp_path / "Foo", **VARIANTS[variant]), VARIANTS[variant]
    assert validate_yaml_file(folder / "policy.yml", "policy") == []
    assert validate_yaml_file(folder / "deploy.yml", "deploy") == []
    (gate,) = engine.audit(folder, "policy", AuditOptions(gates=(Gate.STATIC,))).gates
    found = {result.slug for result in gate.results if result.findings or result.outcome is Outcome.ERROR}
    has_reference = chosen.get("reference", False)
    assert found == {"placeholders", *(["reference-sources"] if has_reference else [])}, gate.results
    assert (folder / "reference.py").exists() == has_reference

    manifest = yaml.safe_load((folder / "policy.yml").read_text())
    cameras = [kinds.camera(text) for text in chosen.get("cameras", ())]
    assert manifest["temporal"].get("history", 1) == chosen.get("history", 1)
    assert manifest["temporal"].get("ensembling") == chosen.get("ensembling")
    assert manifest["cameras"] == {camera.name: {"width": camera.width, "height": camera.height} for camera in cameras}
    assert {f"vision.{camera.name}" for camera in cameras} <= set(manifest["inputs"]["required"])
    kind = kinds.kinds()[chosen.get("kind", kinds.DEFAULT)]
    assert manifest["evaluation_only"] is kind.evaluation_only is not (folder / "train.sh").exists()

    kept = lock.read(folder)
    assert kept is not None
    assert scaffold.recorded_answers(kept) == _answers(**chosen)
    assert update.plan(folder).changes == ()


@pytest.mark.parametrize(("robot", "action_type"), ROBOTS)
@pytest.mark.parametrize("variant", [name for name, chosen in VARIANTS.items() if "kind" not in chosen])
def test_a_fresh_scaffold_holds_the_pose(variant: str, robot: str, action_type: str, tmp_path: Path) -> None:
    """Whether a block converts or code, with grippers and hands, and so does its reference."""
    cameras = ("cam_head",) if "cameras" in VARIANTS[variant] else ()
    chosen = {**VARIANTS[variant], "cameras": cameras, "embodiment": robot, "action_type": action_type, "chunk": 3}
    folder = _written(tmp_path / "Foo", **chosen)
    config, manifest = (yaml.safe_load((folder / name).read_text()) for name in ("deploy.yml", "policy.yml"))
    model = content.load_module(folder / "model.py").Model({**config, "manifest": manifest})
    assert (model.interface is None) == (not chosen.get("block", True))
    observations = [observation(robot, seed) for seed in range(2)]
    for obs in observations:
        model.update_obs(obs)
        chunk = model.get_action()
        check_chunk(chunk, get_embodiment(robot), action_type)
        assert len(chunk) == 3
        for key, value in chunk[-1].items():
            np.testing.assert_allclose(value, obs["state"][key], atol=1e-6)
    if chosen.get("reference"):
        answer = content.load_module(folder / "reference.py").answers({})
        actions = answer(SimpleNamespace(observations=observations, asked=[0, 1]))
        assert len(actions) == 3
        for key, value in chunk[-1].items():
            np.testing.assert_allclose(actions[-1][key], value, atol=1e-6)


@pytest.mark.parametrize("kind", ["minimal", "torch"])
def test_an_adapter_with_a_block_writes_load_and_predict_alone(kind: str) -> None:
    (model,) = ast.parse(scaffold.render(_answers(kind=kind))["model.py"]).body[-1:]
    assert [node.name for node in ast.walk(model) if isinstance(node, ast.FunctionDef)] == ["load", "predict"]


@pytest.mark.parametrize(
    ("kind", "python", "environment"),
    [
        ("torch", "", {"manager": "uv"}),
        ("torch", "3.11", {"manager": "uv", "python": "3.11"}),
        ("torch", "/opt/python", {"manager": "path", "python": "/opt/python"}),
        ("lerobot", "", {"manager": "uv", "python": ">=3.12"}),
        ("remote", "", {"manager": "none"}),
        ("remote", "3.11", {"manager": "uv", "python": "3.11"}),
    ],
)
def test_a_kind_brings_its_environment(kind: str, python: str, environment: dict[str, str]) -> None:
    told = yaml.safe_load(scaffold.render(_answers(kind=kind, python=python))["policy.yml"])["environment"]
    requirements = told.pop("requirements", None)
    assert told == environment
    assert bool(requirements) is (told["manager"] == "uv")


def test_the_next_command_installs_where_there_is_something_to_install(tmp_path: Path) -> None:
    following = {}
    for kind in ("torch", "remote"):
        completed = _xpl(kind.title(), "--kind", kind, "--json", cwd=tmp_path)
        following[kind] = [command.split()[1] for command in json.loads(completed.stdout)["next"]]
    assert following == {"torch": ["install", "audit"], "remote": ["audit"]}


# -- the lock ----------------------------------------------------------------------------------------------------------


def test_a_lock_from_before_there_were_kinds_has_their_defaults(tmp_path: Path) -> None:
    folder = _written(tmp_path / "Foo")
    text = (folder / lock.PATH).read_text()
    start = text.index("  kind: minimal")
    (folder / lock.PATH).write_text(text[:start] + text[text.index("generated:") :])
    package_lock = lock.read(folder)
    assert package_lock is not None
    assert "kind" not in package_lock.answers
    assert scaffold.recorded_answers(package_lock) == _answers()
    assert {change.name for change in update.plan(folder).changes} == {lock.PATH}


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chosen", "message", "hint"),
    [
        ({"kind": "tourch"}, "--kind must be one of minimal, torch, lerobot, remote", "did you mean torch?"),
        ({"history": 0, "kind": "torch"}, "--history must be at least 1", None),
        ({"ensembling": -0.1}, "--ensembling takes a decay of 0 or more", None),
        ({"ensembling": float("nan")}, "--ensembling takes a decay of 0 or more", None),
        ({"ensembling": 0.01, "chunk": 1}, "chunks of one action do not", "--chunk 16"),
        ({"kind": "torch", "cameras": ("cam_haed",)}, "arx_x5 has 2 arms", "did you mean cam_head"),
        ({"kind": "torch", "cameras": ("cam_wrist",)}, "arx_x5 has 2 arms", "cam_left_wrist|cam_right_wrist"),
        ({"kind": "torch", "cameras": ("cam_left_wrist",), "embodiment": "franka_single"}, "has 1 arm,", "cam_wrist"),
        ({"kind": "torch", "cameras": ("cam_head", "cam_head:1x1")}, "names a camera twice", None),
        ({"kind": "torch", "cameras": ("cam_head:0x48",)}, r"width x height\); got 'cam_head:0x48'", None),
        ({"kind": "torch", "cameras": ("",)}, "takes names such as cam_head", None),
    ],
)
def test_what_does_not_fit_is_refused(chosen: dict[str, Any], message: str, hint: str | None) -> None:
    with pytest.raises(UserError, match=message) as caught:
        _answers(**chosen)
    assert hint is None or any(part in str(caught.value.hint) for part in hint.split("|"))


def test_all_options_that_do_not_fit_are_told_at_once(tmp_path: Path) -> None:
    wrong = ["--chunk", "0", "--history", "0", "--action-type", "joints", "--cameras", "cam_haed", "--python", "three"]
    completed = _xpl("class", *wrong, "--kind", "tourch", cwd=tmp_path)
    assert (completed.code, completed.stdout, list(tmp_path.iterdir())) == (2, "", [])
    for message in ("class", "--chunk", "--history", "joint", "cam_head", "--python", "torch"):
        assert message in completed.stderr


# -- what the base class does for them ---------------------------------------------------------------------------------


@given(st.data())
def test_an_ensemble_stays_between_what_was_predicted(data: st.DataObject) -> None:
    decay = data.draw(st.floats(0, 50))
    horizon = data.draw(st.integers(1, 6))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    predictions: dict[int, np.ndarray] = {}
    chunks = {}
    for step in range(data.draw(st.integers(1, 5))):
        chunks[step] = rng.normal(size=(horizon, 3))
        averaged = ensemble(predictions, chunks[step], step, decay)
        for offset, row in enumerate(averaged):
            seen = np.array(
                [chunk[step + offset - made] for made, chunk in chunks.items() if step + offset < made + horizon]
            )
            assert (row >= seen.min(axis=0) - 1e-12).all()
            assert (row <= seen.max(axis=0) + 1e-12).all()
        np.testing.assert_array_equal(averaged[-1], chunks[step][-1])  # nobody else predicted that moment
    assert all(made + horizon > step for made in predictions)


@given(st.floats(0, 5), st.integers(0, 2**32 - 1))
def test_an_ensemble_of_plans_that_agree_is_the_plan(decay: float, seed: int) -> None:
    trajectory = np.random.default_rng(seed).normal(size=(12, 4))
    predictions: dict[int, np.ndarray] = {}
    for step in range(8):
        averaged = ensemble(predictions, trajectory[step : step + 4], step, decay)
        np.testing.assert_allclose(averaged, trajectory[step : step + 4], atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["arx_x5", "franka_single", "tianji_marvin_wuji"]))
def test_joints_are_kept_inside_their_limits(seed: int, name: str) -> None:
    robot = get_embodiment(name)
    rng = np.random.default_rng(seed)
    steps = [{key: rng.normal(0, 3, width).astype(np.float32) for key, width in robot.dims("joint").items()}]
    before = {key: value.copy() for key, value in steps[0].items()}
    (inside,) = within_limits(steps, robot)
    for arm in robot.arms:
        key = arm.prefix + ARM_JOINTS
        expected = before[key] if arm.lower is None else np.clip(before[key], arm.lower, arm.upper)
        np.testing.assert_allclose(inside[key], expected, rtol=1e-6)
        assert inside[key].dtype == np.float32
    others = [key for key in before if not key.endswith(ARM_JOINTS)]
    assert all((inside[key] == before[key]).all() for key in others)
    assert all((steps[0][key] == before[key]).all() for key in before)


# -- the gates ---------------------------------------------------------------------------------------------------------


def test_a_remote_policy_passes_every_request_on(tmp_path: Path) -> None:
    behind, adapter = _written(tmp_path / "Behind", chunk=2), _written(tmp_path / "Far", kind="remote", chunk=2)
    with running_server(behind) as server:
        _point(adapter, server.url)
        with running_server(adapter) as far, Client(far.url) as policy:
            policy.update_obs(_observation(0))
            assert [_position(step) for step in policy.get_action()] == [0, 0]
            policy.reset()
            with pytest.raises(PolicyServerError, match="needs an observation"):
                policy.get_action()
            policy.update_obs_batch([{**_observation(env), "env_idx": env} for env in (1, 2, 3)])
            chunks = policy.get_action_batch([3, 1])
            assert [[_position(step) for step in chunk] for chunk in chunks] == [[3, 3], [1, 1]]


def _observation(number: int) -> dict[str, Any]:
    """Return what a robot with two arms shows whose first joint is at `number` tenths of a radian."""
    dims = get_embodiment("arx_x5").dims("joint")
    return {"state": {key: np.full(width, number / 10, np.float32) for key, width in dims.items()}}


def _position(step: dict[str, Any]) -> int:
    """Return the number of the observation that an action holds."""
    return round(float(step[f"left_{ARM_JOINTS}"][0]) * 10)


@pytest.mark.slow
def test_a_remote_policy_for_another_robot_is_refused_before_the_first_step(tmp_path: Path) -> None:
    behind = _written(tmp_path / "Behind", embodiment="franka_single")
    adapter = _written(tmp_path / "Far", kind="remote")
    with running_server(behind) as server:
        _point(adapter, server.url)
        with pytest.raises(UserError, match="franka_single"), running_server(adapter):
            pass  # pragma: no cover


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_remote_policy_passes_all_gates(tmp_path: Path) -> None:
    chosen = {"ensembling": 0.01}
    behind, adapter = _written(tmp_path / "Behind", **chosen), _written(tmp_path / "Far", kind="remote", **chosen)
    with running_server(behind, options=PLACES) as server:
        _point(adapter, server.url)
        assert _bad(adapter, *Gate) == []


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("variant", ["ensembling", "torch", "lerobot"])
def test_every_kind_passes_all_gates_without_its_libraries(variant: str, tmp_path: Path) -> None:
    """The shadow takes the place of the model where it cannot be had; nothing else is left out."""
    small = {"cameras": ("cam_head:64x48",)} if "cameras" in VARIANTS[variant] else {}
    folder = _written(tmp_path / "Foo", **{**VARIANTS[variant], **small, "python": ""})
    assert _bad(folder, *Gate) == []


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_remote_policy_runs_in_an_environment_of_its_own(tmp_path: Path) -> None:
    behind = _written(tmp_path / "Behind")
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    adapter = _written(tmp_path / "Far", kind="remote", python=version)
    completed = subprocess.run(
        [sys.executable, "-m", "xpl_cli", "install", str(adapter)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    if completed.returncode:
        pytest.skip(f"packages cannot be installed here: {completed.stderr.strip().splitlines()[-1]}")
    with running_server(behind, options=PLACES) as server:
        _point(adapter, server.url)
        assert _bad(adapter, Gate.OFFLINE, names=("action-structure", "batch-order", "reset-twice")) == []


def _point(adapter: Path, url: str) -> None:
    """Write the server's address into deploy.yml, as its author would."""
    path = adapter / "deploy.yml"
    path.write_text(path.read_text().replace("ws://localhost:8000", url))
