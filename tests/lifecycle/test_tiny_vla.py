"""policy/Tiny_VLA: what lies in the repository is what policy.yml says; it is trained, resumed and served for real."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl.worker.loading import load_model_class

POLICY = ROOT / "policy" / "Tiny_VLA"
PYTHONS = (os.environ.get("XPL_TORCH_PYTHON"), str(POLICY / ".venv" / "bin" / "python"))
"""Interpreters that may have torch, safetensors, h5py and Pillow: one that is named, or what `xpl install` made."""

BATCHES = """
import json, sys
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[2])
from xpl.worker.loading import load_model_class

folder = Path(sys.argv[1])
model = load_model_class(folder)(json.loads(sys.argv[3]))
draw = np.random.default_rng(0)
words = ["Lift the red block off the table.", "Take the zyxwv thing, 7 times!", "", "word " * 90]
inputs = {
    "head": draw.integers(0, 256, (4, 96, 96, 3), dtype=np.uint8),
    "wrist": draw.integers(0, 256, (4, 96, 96, 3), dtype=np.uint8),
    "state": draw.standard_normal((4, 7)).astype(np.float32),
    "instruction": words,
}
together = model.predict(inputs, [0, 1, 2, 3])
alone = [model.predict({name: values[row : row + 1] for name, values in inputs.items()}, [row])[0] for row in range(4)]
same = {**inputs, "instruction": words[:1] * 4}
print(json.dumps({
    "shape": together.shape,
    "finite": bool(np.isfinite(together).all()),
    "apart": float(np.abs(together - np.stack(alone)).max()),
    "heard": np.abs(together - model.predict(same, [0, 1, 2, 3])).max((1, 2)).tolist(),
}))
"""

CUT = """
import sys
sys.path.insert(0, ".")
import fit, train

def learn(self, batch, rate, learn=fit.Fit.learn):
    if self.step == 2:
        sys.exit()
    return learn(self, batch, rate)

fit.Fit.learn, train.SAVED = learn, 0.0
train.main()
"""
"""A training that saves after each step, and ends in the middle."""


def test_the_weights_are_those_that_are_declared() -> None:
    """Digest and size, and sizes of the network that policy.yml's answer has; deploy.yml serves them."""
    manifest = yaml.safe_load((POLICY / "policy.yml").read_text())
    (declared,) = manifest["checkpoints"]
    file = POLICY / declared["source"]
    held = file.read_bytes()
    assert (hashlib.sha256(held).hexdigest(), len(held)) == (declared["sha256"], declared["size"])
    assert yaml.safe_load((POLICY / "deploy.yml").read_text())["ckpt_name"] == declared["source"]
    length = struct.unpack("<Q", held[:8])[0]
    sizes = json.loads(json.loads(held[8 : 8 + length])["__metadata__"]["sizes"])
    assert sizes["chunk"] >= manifest["model_io"]["action"]["steps"] == manifest["temporal"]["chunk"]
    assert sizes["dim"] == 7


def test_the_static_gate_finds_nothing() -> None:
    """Nor does it warn: every convention of the second reading names its source."""
    done = xpl("audit", str(POLICY), "--gate", "static", "--json", cwd=ROOT)
    assert done.returncode == 0, done.stderr + done.stdout
    (gate,) = json.loads(done.stdout)["targets"][0]["gates"]
    assert {result["outcome"] for result in gate["results"]} == {"pass", "not_applicable"}


@pytest.mark.slow
def test_everything_around_the_network_holds_without_it() -> None:
    """In shadow mode, where something stands in for torch: batches, episodes, transport."""
    done = xpl("audit", str(POLICY), "--gate", "static", "--gate", "offline", "--shadow", cwd=ROOT)
    assert done.returncode == 0, done.stderr + done.stdout


@pytest.fixture
def python() -> str:
    """Return an interpreter that has what the policy needs."""
    for candidate in filter(None, PYTHONS):
        if Path(candidate).exists():
            return candidate
    pytest.skip("no Python with torch: `xpl install policy/Tiny_VLA`, or name one in XPL_TORCH_PYTHON")


@pytest.mark.slow
def test_any_words_in_any_batch_are_answered_and_heard(python: str) -> None:
    """Unknown words, none, and too many; a batch answers as each by itself; other words are another answer."""
    config = {**yaml.safe_load((POLICY / "deploy.yml").read_text()), "manifest": _manifest()}
    done = subprocess.run(
        [python, "-c", BATCHES, str(POLICY), str(ROOT), json.dumps(config)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["shape"] == [4, 16, 7]
    assert told["finite"]
    assert told["apart"] < 1e-4
    assert told["heard"][0] == 0
    assert min(told["heard"][1:]) > 1e-3


@pytest.mark.slow
def test_a_training_that_was_cut_ends_where_a_whole_one_does(python: str, tmp_path: Path) -> None:
    """Four steps in one run, or two and two: the weights are equal; and what was trained is loaded and answers."""
    package = tmp_path / "policy" / "Tiny_VLA"
    shutil.copytree(POLICY, package, ignore=shutil.ignore_patterns(".venv", "weights", "__pycache__"))
    _windows(package / "data" / "whole" / "000.npz")
    small = {"width": 32, "heads": 2, "encoder": 1, "decoder": 1, "dropout": 0.1}
    base = {"seed": 3, "batch": 4, "minutes": None, "run_name": None, "data": "whole", "network": small}

    def trained(name: str, *script: str) -> dict[str, np.ndarray]:
        config = {**base, "ckpt_name": name, "steps": 4}
        environment = {**os.environ, "XPL_CONFIG": json.dumps(config), "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [python, *script], cwd=package, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return _numbers(package / "checkpoints" / name / "training.safetensors")

    whole = trained("whole", "train.py")
    cut = trained("parts", "-c", CUT)
    parts = trained("parts", "train.py")
    assert whole.keys() == cut.keys() == parts.keys()
    assert any(not np.array_equal(cut[name], values) for name, values in whole.items())
    assert all(np.array_equal(parts[name], values) for name, values in whole.items())
    config = {**yaml.safe_load((POLICY / "deploy.yml").read_text()), "ckpt_name": "whole", "manifest": _manifest()}
    done = subprocess.run(
        [python, "-c", BATCHES, str(package), str(ROOT), json.dumps(config)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["shape"] == [4, 16, 7]


def test_conversions_hold_without_torch() -> None:
    """`xpl prepare` makes windows in a Python that has no torch: model.py imports it in `load` alone."""
    assert load_model_class(POLICY).__name__ == "Model"


def _manifest() -> dict[str, Any]:
    manifest: dict[str, Any] = yaml.safe_load((POLICY / "policy.yml").read_text())
    return manifest


def _windows(file: Path) -> None:
    """Write windows of two episodes of noise, whose grippers close."""
    draw = np.random.default_rng(0)
    file.parent.mkdir(parents=True)
    targets = draw.standard_normal((10, 16, 7)).astype(np.float32)
    targets[:, :, -1] = np.where(np.arange(10)[:, None] % 5 > 2, -1, 1)
    np.savez(
        file,
        head=draw.integers(0, 256, (10, 96, 96, 3), dtype=np.uint8),
        wrist=draw.integers(0, 256, (10, 96, 96, 3), dtype=np.uint8),
        state=draw.standard_normal((10, 7)).astype(np.float32),
        instruction=np.array(["lift the red one"] * 5 + ["lift the blue one"] * 5),
        targets=targets,
        starts=np.array([0, 5, 10]),
    )


def _numbers(file: Path) -> dict[str, np.ndarray]:
    """Return the tensors of a safetensors file of float32."""
    held = file.read_bytes()
    length = struct.unpack("<Q", held[:8])[0]
    entries = {name: entry for name, entry in json.loads(held[8 : 8 + length]).items() if name != "__metadata__"}
    body = held[8 + length :]
    return {name: np.frombuffer(body[slice(*entry["data_offsets"])], np.float32) for name, entry in entries.items()}
