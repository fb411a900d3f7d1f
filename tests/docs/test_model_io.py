"""The worked example of docs/model-io.md compiles, runs, and means what the page says."""

from __future__ import annotations

import json
import sys
import types
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from tests.support import pages
from tests.support.adapters import parity
from tests.support.adapters.model_io import observation
from tests.support.checkout import ROOT
from xpl_cli.model_io import record
from xpl_cli.packages import package

if TYPE_CHECKING:
    from pathlib import Path

BLOCKS = list(pages.blocks([ROOT / "docs" / "model-io.md"]))
MANIFEST = next(yaml.safe_load(block.text) for block in BLOCKS if block.language == "yaml")
CODE = [block.text for block in BLOCKS if block.language == "python"]
WIDTH = 16
Q01, Q99 = np.full(WIDTH, -0.5), np.full(WIDTH, 1.5)


@pytest.fixture
def policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the page's adapter, in a folder of its own with statistics."""
    stats = {"q01": Q01.tolist(), "q99": Q99.tolist()}
    (tmp_path / "norm_stats.json").write_text(json.dumps({"norm_stats": {"state": stats, "actions": stats}}))
    module = types.ModuleType("model_io_example")
    module.__file__ = str(tmp_path / "model.py")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(CODE[0], module.__file__, "exec"), vars(module))  # noqa: S102 - what the page shows
    return module.Model({"env_cfg_type": "franka", "action_type": "joint", "manifest": MANIFEST})


def _state(obs: dict[str, Any]) -> np.ndarray:
    fields = [f"{side}_{name}" for side in ("left", "right") for name in ("arm_joint_state", "ee_joint_state")]
    return np.concatenate([obs["state"][field] for field in fields])


def test_the_example_runs(policy: Any) -> None:
    calls: list[tuple[np.ndarray, ...]] = []
    network = policy.network

    def watched(*inputs: Any) -> Any:
        calls.append(inputs)
        return network(*inputs)

    policy.network = watched
    observations = [{**observation("franka", env, (48, 64)), "env_idx": env} for env in range(2)]
    policy.update_obs_batch(observations)
    chunks = policy.get_action_batch()
    ((images, state, prompt),) = calls
    assert (images.shape, state.shape) == ((2, 3, 224, 224, 3), (2, 32))
    assert {images.dtype, state.dtype} == {np.dtype(np.float32)}
    assert prompt == ["Fold it.", "Fold it."]
    assert (images[:, :, :28] == -1).all()  # above the picture there is black
    for row, obs, chunk in zip(state, observations, chunks, strict=True):
        expected = (_state(obs) - Q01) / (Q99 - Q01 + 1e-6) * 2 - 1
        assert row == pytest.approx([*expected, *[0] * 16], abs=1e-5)
        assert len(chunk) == 50
        for side in ("left", "right"):
            assert chunk[0][f"{side}_arm_joint_state"] == pytest.approx(
                obs["state"][f"{side}_arm_joint_state"] + 0.5, abs=1e-5
            )
            assert chunk[49][f"{side}_ee_joint_state"] == pytest.approx([0.5], abs=1e-5)


def test_the_example_of_both_directions_runs() -> None:
    space: dict[str, Any] = {}
    exec(compile(CODE[1], "model-io.md", "exec"), space)  # noqa: S102 - what the page shows
    parts = [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 0.08}}]
    model_io = {"state": [{"input": "s", "parts": parts}], "action": {"reference": "absolute", "parts": parts}}
    obs = space["to_observation"](model_io, {"s": [*[0.3] * 7, 0.02]}, observation("franka_single"))
    assert obs["state"]["arm_joint_state"] == pytest.approx([0.3] * 7)
    assert obs["state"]["ee_joint_state"] == pytest.approx([0.25])


AUTHORS = """import numpy as np


class Policy:
    def __init__(self, checkpoint):
        self.gain = 0.1

    def act(self, inputs, text):
        picture = np.asarray(inputs["agentview"], np.float64).mean((0, 1)) / 255
        row = np.append(inputs["qpos"] + self.gain * picture.sum(), 0.04 * len(text) / 80)
        return np.stack([row, row + 0.001])
"""


def test_the_reference_of_the_page_can_be_recorded(tmp_path: Path) -> None:
    code = next(text for text in CODE if "def answers" in text)
    folder = parity.write_adapter(tmp_path / "Foo", None, code=code)
    (folder / "authors").mkdir()
    (folder / "authors/policy.py").write_text(AUTHORS)
    done = record.record(package.load(folder), record.RecordOptions())
    assert (done.conventions, done.assumed[0]) == (12, "joint_order")
    assert len(done.assumed) == 10  # one is marked so, nine have no source
    assert set(done.pairs.provenance["reference"]) == {"reference.py", "authors/policy.py"}
