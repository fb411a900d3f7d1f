"""What a policy is trained on is what it is served, bit by bit, and its answers decode to the recorded actions."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters.model_io import CASES, Case, observation, steps
from xpl import training
from xpl.trajectory import Folder, Writer, open_folder
from xpl.worker.loading import load_model_class

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

PLAIN = """
from xpl import Policy


class Model(Policy):
    def load(self, config):
        self.given = []

    def predict(self, inputs, envs):
        self.given.append(inputs)
        raise RuntimeError("asked")
"""
OWN = (
    PLAIN
    + """
    def encode(self, obs, env):
        return {**super().encode(obs, env), "scene": obs["state"]["arm_joint_state"][:2] * 10}
"""
)
LENGTHS = (3, 6)
CHUNK = 4


def _package(folder: Path, text: str) -> Path:
    package = folder / "Package"
    package.mkdir()
    (package / "model.py").write_text(text)
    return package


def _config(case: Case, **model_io: Any) -> dict[str, Any]:
    block = {**copy.deepcopy(case.model_io), **model_io}
    history = block.get("history", {}).get("length", 1)
    chunk = block["action"].get("steps", CHUNK)
    manifest = {"temporal": {"chunk": chunk, "history": history}, "model_io": block}
    return {"env_cfg_type": case.robot, "action_type": case.action_type, "manifest": manifest}


def _set(folder: Path, case: Case, lengths: tuple[int, ...] = LENGTHS) -> Folder:
    for number, length in enumerate(lengths):
        rng = np.random.default_rng(number)
        facts = {"embodiment": case.embodiment.name}
        with Writer(folder / f"episode_{number}.hdf5", images="raw", episode=facts) as episode:
            for step, action in enumerate(steps(case, rng, length)):
                episode.add(observation(case.robot, 100 * number + step), action)
    return open_folder(folder)


def _served(package: Path, config: Mapping[str, Any], demonstrations: Folder) -> list[dict[str, Any]]:
    model = load_model_class(package)(config)
    for episode in demonstrations:
        model.reset()
        for obs, _ in episode:
            model.update_obs(obs)
            with pytest.raises(RuntimeError, match="asked"):
                model.get_action()
    given: list[dict[str, Any]] = model.given
    return given


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, list):
        return bool(one == other)
    return one.dtype == other.dtype and np.array_equal(one, other)


@pytest.mark.parametrize("name", CASES)
def test_inputs_are_those_that_are_served_bit_by_bit(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    package, demonstrations = _package(tmp_path, PLAIN), _set(tmp_path / "set", case)
    windows = training.windows(package, _config(case), demonstrations)
    served = _served(package, _config(case), demonstrations)
    assert len(windows) == len(served) == sum(LENGTHS)
    together = windows.batch(range(len(windows)))
    for row, given in enumerate(served):
        alone = windows.batch([row])
        assert alone.keys() == given.keys()
        for key, value in given.items():
            assert _equal(alone[key], value), (row, key)
            assert _equal(together[key][row : row + 1], value), (row, key)


@pytest.mark.parametrize("name", CASES)
def test_answers_decode_to_the_recorded_actions(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    package, demonstrations = _package(tmp_path, PLAIN), _set(tmp_path / "set", case)
    config = _config(case)
    config["manifest"]["model_io"]["action"].pop("first", None)
    windows = training.windows(package, config, demonstrations)
    interface = training.without_model(package, config).interface
    assert interface is not None
    row = 0
    for episode in demonstrations:
        actions, commands = [action for _, action in episode], dict[str, np.ndarray]()
        for step, (obs, _) in enumerate(episode):
            told = dict(commands)
            decoded = interface.decode(windows.targets[row], obs, told)
            for ahead, found in enumerate(decoded):
                wanted = actions[min(step + ahead, len(actions) - 1)]
                for key, values in found.items():
                    assert _near(values, wanted[key]), (row, ahead, key)
            assert windows.padded[row].tolist() == [step + ahead >= len(actions) for ahead in range(len(decoded))]
            interface.action.encode([actions[step]], obs["state"], commands)  # it was executed: the next counts from it
            row += 1


def _near(one: np.ndarray, other: np.ndarray) -> bool:
    turned = one.shape == (7,) and abs(float(one[3:] @ other[3:])) > 1 - 1e-6  # a quaternion has two signs
    return np.allclose(one, other, atol=2e-3) or (turned and np.allclose(one[:3], other[:3], atol=2e-3))


def test_an_adapters_own_inputs_are_those_that_are_served(tmp_path: Path) -> None:
    image = {"input": "top", "cameras": ["cam_head"], "channels": "bgr", "layout": "chw", "dtype": "float32"}
    model_io = {
        "images": [{**image, "range": [0, 1], "mean": [0.4, 0.5, 0.6], "std": [0.2, 0.25, 0.3]}],
        "state": [{"input": "q", "parts": [{"joints": {"arm": "single"}}]}],
        "history": {"length": 2},
        "action": CASES["one arm, cumulative poses"].model_io["action"],
    }
    case = CASES["one arm, cumulative poses"]
    config = _config(Case(case.robot, case.action_type, model_io))
    package, demonstrations = _package(tmp_path, OWN), _set(tmp_path / "set", case)
    windows = training.windows(package, config, demonstrations)
    assert windows.inputs["top"].dtype == np.uint8  # type: ignore[union-attr]
    assert set(windows.history_rows) == {"top", "q", "scene"}
    for row, given in enumerate(_served(package, config, demonstrations)):
        (frames,) = given
        found = windows.batch([row])
        for key in ("top", "q", "scene"):
            assert _equal(found[key][0], np.stack([frame[key] for frame in frames])), (row, key)
    batched = training.without_model(package, config).interface.batch(_served(package, config, demonstrations)[-1])  # type: ignore[union-attr]
    assert batched["scene"].shape == (1, 2, 2)


def test_images_that_are_no_bytes_before_their_numbers_are_kept_as_numbers(tmp_path: Path) -> None:
    case = CASES["two arms, joint deltas"]
    resize = {"resize": {"to": [9, 13], "filter": "bilinear", "as": "float32"}}
    image = {"input": "top", "cameras": ["cam_head"], "channels": "rgb", "layout": "hwc", "dtype": "float32"}
    config = _config(case, images=[{**image, "steps": [resize]}])
    package, demonstrations = _package(tmp_path, PLAIN), _set(tmp_path / "set", case, (2,))
    windows = training.windows(package, config, demonstrations)
    assert windows.inputs["top"].dtype == np.float32  # type: ignore[union-attr]
    assert not windows.pixels


def test_statistics_are_of_the_models_own_numbers(tmp_path: Path) -> None:
    case = CASES["two arms, joint deltas"]
    config = _config(case)
    action = config["manifest"]["model_io"]["action"]
    action.update(reference="absolute", normalize={"rule": "min_max", "file": "later.safetensors", "key": "action"})
    package, demonstrations = _package(tmp_path, PLAIN), _set(tmp_path / "set", case)
    found = training.statistics(package, config, demonstrations, horizon=4, first=-1)
    rows = np.stack(
        [
            np.concatenate(
                [
                    np.ravel(values)
                    for values in training.without_model(
                        package, config, normalized=False, images=False
                    ).interface.action.encode([step], obs["state"])
                ]
            )  # type: ignore[union-attr]
            for episode in demonstrations
            for obs, step in episode
        ]
    )
    assert found["action"]["count"].tolist() == [sum(LENGTHS)]
    np.testing.assert_allclose(found["action"]["mean"], rows.mean(0), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(found["action"]["min"], rows.min(0), rtol=1e-6)
    np.testing.assert_allclose(found["action"]["q99"], np.quantile(rows, 0.99, axis=0), rtol=1e-5)


def test_windows_begin_where_the_answer_does(tmp_path: Path) -> None:
    case = CASES["two arms, joint deltas"]
    config = _config(case)
    config["manifest"]["model_io"]["action"]["reference"] = "absolute"
    package, demonstrations = _package(tmp_path, PLAIN), _set(tmp_path / "set", case, (5,))
    now = training.windows(package, config, demonstrations, horizon=3)
    early = training.windows(package, config, demonstrations, horizon=8, first=-1)
    assert early.targets.shape[1] == 8
    np.testing.assert_array_equal(early.targets[1:, 0], now.targets[:-1, 0])
    assert early.padded[0].tolist() == [True, False, False, False, False, False, True, True]


@pytest.mark.parametrize(
    ("change", "text", "told"),
    [
        ({"env_cfg_type": "franka_single", "action_type": "ee"}, PLAIN, "was recorded with"),
        ({"action_type": "ee"}, PLAIN, "has no"),
        ({}, PLAIN.replace("(Policy)", ""), "no xpl.Policy"),
        ({}, PLAIN + "\n    def decode(self, raw, obs, env):\n        return []\n", "no inverse"),
    ],
)
def test_a_set_that_does_not_fit_is_told(tmp_path: Path, change: dict[str, Any], text: str, told: str) -> None:
    case = CASES["two arms, joint deltas"]
    parts = [
        {part: how}
        for arm in ("left", "right")
        for part, how in (
            ("position", {"arm": arm}),
            ("rotation", {"arm": arm, "form": "matrix"}),
            ("gripper", {"arm": arm, "closed": 0, "open": 1}),
        )
    ]
    config = {**_config(case), **change}
    if config["env_cfg_type"] != case.robot:
        parts = [{kind: {**how, "arm": "single"}} for part in parts[:3] for kind, how in part.items()]
    if change:
        config["manifest"]["model_io"] = {"action": {"reference": "absolute", "parts": parts}}
    package, demonstrations = _package(tmp_path, text), _set(tmp_path / "set", case, (2,))
    with pytest.raises(training.TrainingError, match=told):
        training.windows(package, config, demonstrations)
