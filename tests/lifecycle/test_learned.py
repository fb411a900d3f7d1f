"""ACT and Diffusion Policy of LeRobot: prepared, trained and asked; `XPL_LEROBOT_PYTHON` names a Python with LeRobot.

CONTRIBUTING.md says how to make such a Python. Without it only what needs no LeRobot is run.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters.learned import PYTHON, needed, small
from tests.support.checkout import ROOT, copy
from tests.support.killable import Server
from tests.support.peer import xpl
from xpl import Client, training
from xpl.trajectory import Writer
from xpl_cli.basics.errors import ExitCode
from xpl_cli.isolation import subprocess_task
from xpl_cli.packages import package

if TYPE_CHECKING:
    from pathlib import Path

NAMES = ("ACT", "DiffusionPolicy")
STATE = ("--set", "variant=state")


@pytest.mark.parametrize("robot", ["arx_x5_single", "sawyer"])
@pytest.mark.parametrize("name", NAMES)
def test_the_scene_is_an_input_of_its_own(name: str, robot: str) -> None:
    """Of our tasks objects and goals in decimetres, of Meta-World its own observation."""
    obs = _observation()
    if robot == "sawyer":
        obs["privileged"] = {"observation": np.arange(39.0)}
    config = {"env_cfg_type": robot, "action_type": "ee", "seed": 0, "variant": "state"}
    policy = training.without_model(ROOT / "policy" / name, config, normalized=False)
    policy.update_obs(obs)
    (inputs,) = policy.encodings(0)
    scene = inputs["observation.environment_state"]
    assert inputs["observation.state"].shape == (10,)
    if robot == "sawyer":
        assert scene.shape == (21,)
        assert scene[-1] == 38 * 5
    else:
        np.testing.assert_allclose(scene, [1, 2, 3, 1, 0, 0, 0, 1, 0], atol=1e-6)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@needed
@pytest.mark.parametrize("name", NAMES)
def test_a_policy_goes_the_whole_way(tmp_path: Path, name: str) -> None:
    """Demonstrations, statistics, steps whose loss falls, and an episode: the checkpoint is found and answers."""
    folder = small(tmp_path, name)
    _recorded(tmp_path / "demos")
    given = (*STATE, "--set", f"demonstrations={tmp_path / 'demos'}", "--set", "batch=4", "--set", "ckpt_name=mine")
    assert _clean(xpl("prepare", str(folder), *given, cwd=tmp_path))
    assert _clean(xpl("train", str(folder), *given, "--set", "steps=300", cwd=tmp_path))
    log = (folder / "checkpoints" / "mine" / "log.jsonl").read_text(encoding="utf-8").splitlines()
    losses = [json.loads(line)["loss"] for line in log]
    assert all(np.isfinite(losses))
    assert losses[-1] < losses[0]
    played = xpl(
        *("eval", str(folder), "--env", "mujoco", "--task", "lift_cube", "--episodes", "1", "--set", "ckpt_name=mine"),
        *(*STATE, "--out", str(tmp_path / "eval"), "--film", "0"),
        cwd=tmp_path,
    )
    assert played.returncode in (ExitCode.CLEAN, ExitCode.FINDINGS), played.stderr


@pytest.mark.slow
@pytest.mark.timeout(1800)
@needed
@pytest.mark.parametrize("name", NAMES)
def test_a_training_that_was_killed_ends_as_one_that_was_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The same weights, byte for byte, and the same curve: saved after each step, killed after a hundred."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    folder = small(tmp_path, name)
    _recorded(tmp_path / "demos")
    given = (*STATE, "--set", f"demonstrations={tmp_path / 'demos'}", "--set", "batch=4", "--set", "steps=220")
    whole, cut = (folder / "checkpoints" / one for one in ("whole", "cut"))
    for place in (whole, cut):
        assert _clean(xpl("prepare", str(folder), *given, "--set", f"ckpt_name={place.name}", cwd=tmp_path))
    assert _clean(xpl("train", str(folder), *given, "--set", "ckpt_name=whole", cwd=tmp_path))
    again = ("train", str(folder), *given, "--set", "ckpt_name=cut", "--set", "save_every=0")
    begun = subprocess.Popen(
        [sys.executable, "-m", "xpl_cli", *again],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert begun.stdout is not None
    said = next(line for line in begun.stdout if "'step': 100" in line)
    os.killpg(begun.pid, signal.SIGKILL)
    begun.communicate()
    assert (cut / ".training.pt").exists(), said
    assert not (cut / "model.safetensors").exists()
    assert _clean(xpl(*again, cwd=tmp_path))
    assert (cut / "model.safetensors").read_bytes() == (whole / "model.safetensors").read_bytes()
    assert _curve(cut) == _curve(whole)
    assert [step for step, _ in _curve(cut)] == [100, 200]
    assert not (cut / ".training.pt").exists()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@needed
@pytest.mark.parametrize("name", NAMES)
def test_what_ships_answers_a_client_as_it_answers_in_one_process(tmp_path: Path, name: str) -> None:
    """To the last bit: XPL255 cannot ask a policy that wants what only a simulator tells, so this does."""
    folder = copy(tmp_path, f"policy/{name}/**") / "policy" / name
    found = package.load(str(folder), {"variant": "state"})
    place = subprocess_task.TaskSettings(python=PYTHON, checkout=folder, patience=600, limit_s=1800)
    seen = [{**_observation(step), "env_idx": 0} for step in range(6)]
    calls: list[tuple[str, list[Any]]] = [("reset", [])]
    for obs in seen:
        calls += [("update_obs", [obs]), ("get_action", [])]
    order = {"policy_dir": str(folder), "config": found.config({}), "manifest": found.manifest.data, "script": calls}
    done = subprocess_task.run("xpl.worker.inprocess", {**order, "watch": False}, place)
    local = [
        answer.result for answer, (method, _) in zip(done.answers[1:], calls, strict=True) if method == "get_action"
    ]
    with Server(folder, "--python", PYTHON, *STATE) as server, Client(server.url) as client:
        client.reset()
        remote = []
        for obs in seen:
            client.update_obs(obs)
            remote.append(client.get_action())
    for one, other in zip(local, remote, strict=True):
        assert [sorted(step) for step in one] == [sorted(step) for step in other]
        for step, same in zip(one, other, strict=True):
            for key, values in step.items():
                assert np.asarray(values).tobytes() == np.asarray(same[key]).tobytes()


def _curve(checkpoint: Path) -> list[tuple[int, float]]:
    lines = (checkpoint / "log.jsonl").read_text(encoding="utf-8").splitlines()
    return [(told["step"], told["loss"]) for told in map(json.loads, lines)]


def _clean(done: subprocess.CompletedProcess[str]) -> bool:
    assert done.returncode == ExitCode.CLEAN, done.stderr
    return True


def _observation(step: int = 0) -> dict[str, Any]:
    pose = np.array([0.3 + 0.01 * step, 0.0, 0.2, 0.0, 1.0, 0.0, 0.0])
    return {
        "state": {"arm_joint_state": np.zeros(6), "ee_joint_state": np.array([1.0]), "ee_pose": pose, "tcp_pose": pose},
        "vision": {},
        "instruction": "Lift the cube.",
        "privileged": {"objects": {"cube": {"pose": np.array([0.1, 0.2, 0.3, 1.0, 0, 0, 0]), "half_size": np.ones(3)}}},
    }


def _recorded(folder: Path) -> None:
    for number in range(2):
        facts = {"embodiment": "arx_x5_single"}
        with Writer(folder / f"episode_{number}.hdf5", episode=facts, privileged=True) as episode:
            for step in range(20):
                ahead = _observation(step + 1)["state"]
                action = {key: ahead[key] for key in ("ee_pose", "ee_joint_state")}
                episode.add(_observation(step), action)
