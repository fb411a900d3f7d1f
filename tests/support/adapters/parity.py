"""An adapter with a model_io block, and the reference code of its authors, small enough to be recorded in a test."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import yaml

from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers

if TYPE_CHECKING:
    from pathlib import Path

NETWORK = '''"""The authors' network: a fixed function of numbers, which sees every pixel, number and letter."""

import zlib

import numpy as np

STEPS, ACTIONS = 4, 8


class Network:
    def __init__(self):
        rng = np.random.default_rng(3)
        self.view, self.memory = {}, rng.normal(size=(8, ACTIONS))
        self.rng = rng
        self.time = rng.normal(size=(STEPS, ACTIONS))

    def __call__(self, image, state, prompt):
        """image (h, w, 3) float, state (8,), prompt text: (STEPS, ACTIONS), all in -1..1."""
        if image.shape not in self.view:
            self.view[image.shape] = np.random.default_rng(image.size).normal(size=(image.size, ACTIONS)) / 40
        said = np.frombuffer(zlib.crc32(prompt.encode()).to_bytes(4, "little") * 2, np.uint8) / 255 - 0.5
        seen = image.reshape(-1) @ self.view[image.shape] + state @ self.memory / 3 + said
        return np.tanh(seen + self.time)
'''

MODEL = """import numpy as np

from xpl import Policy

from .network import Network


class Model(Policy):
    def load(self, config):
        self.network = Network()

    def predict(self, inputs, envs):
        rows = zip(inputs["image"], inputs["state"], inputs["prompt"])
        return np.stack([self.network(*row) for row in rows])
"""

REFERENCE = '''"""Answers as the authors' rollout does."""

import numpy as np

from .network import Network

CONVENTIONS = {
    "image_channels": "authors/rollout.py:12",
    "image_range": "authors/rollout.py:13",
    "gripper": "authors/dataset.py:40",
    "action_reference": "authors/dataset.py:55",
    "joint_order": "assumed: the authors number them",
    "angle_unit": "assumed",
}
SPAN = np.pi


def answers(config):
    network = Network()

    def answer(episode):
        now = episode.observations[-1]
        image = now["vision"]["cam_head"]["color"][1::2, 1::2, ::-1] / 127.5 - 1
        joints = np.asarray(now["state"]["arm_joint_state"], np.float64)
        finger = 0.04 * float(now["state"]["ee_joint_state"][0])
        state = np.concatenate([joints / SPAN, [2 * finger / 0.04 - 1]]).astype(np.float32)
        prompt = "Task: " + now["instruction"].strip(" ").lower()
        said = network(image.astype(np.float32), state, prompt)
        steps = []
        for row in said:
            opening = np.clip((row[7] + 1) / 2, 0, 1)
            steps.append({
                "arm_joint_state": (joints + 0.1 * row[:7]).astype(np.float32),
                "ee_joint_state": np.array([opening], np.float32),
            })
        return steps

    return answer
'''

_SPAN = 3.141592653589793
BLOCK: dict[str, Any] = {
    "images": [
        {
            "input": "image",
            "cameras": ["cam_head"],
            "steps": [{"resize": {"to": [24, 32], "filter": "nearest"}}],
            "channels": "bgr",
            "layout": "hwc",
            "dtype": "float32",
            "range": [-1, 1],
        }
    ],
    "state": [
        {
            "input": "state",
            "parts": [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 0.04}}],
            "normalize": {"rule": "min_max", "values": {"min": [-_SPAN] * 7 + [0.0], "max": [_SPAN] * 7 + [0.04]}},
        }
    ],
    "instruction": {"input": "prompt", "template": "Task: {instruction}", "case": "lower", "strip": " "},
    "action": {
        "reference": "delta_state",
        "parts": [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 1.0}}],
        "normalize": {"rule": "min_max", "values": {"min": [-0.1] * 7 + [0.0], "max": [0.1] * 7 + [1.0]}},
    },
}


def block(**changes: Any) -> dict[str, Any]:
    """Return the block with some of its keys changed."""
    return {**copy.deepcopy(BLOCK), **changes}


def manifest(name: str, model_io: dict[str, Any] | None, **changes: Any) -> dict[str, Any]:
    """Return the policy.yml of the adapter."""
    told = {
        "spec": "v1",
        "name": name,
        "summary": "A small network that reads one camera, the state and the instruction.",
        "family": "other",
        "paper": None,
        "upstream": None,
        "license": "MIT",
        "temporal": {"kind": "chunk", "chunk": 4},
        "control_frequency": None,
        "inputs": {
            "required": ["instruction", "vision.cam_head", "state.arm_joint_state", "state.ee_joint_state"],
            "optional": [],
            "unused": ["state.ee_pose", "vision.cam_wrist"],
        },
        "cameras": {"cam_head": {"height": 48, "width": 64, "exact": True}},
        "embodiments": ["franka_single"],
        "action_types": ["joint"],
        "gripper": {"command": "position"},
        "deterministic": True,
        "evaluation_only": True,
        "environment": {"manager": "none"},
        **changes,
    }
    return told if model_io is None else {**told, "model_io": model_io}


def write_adapter(
    folder: Path,
    model_io: dict[str, Any] | None = BLOCK,
    *,
    model: str = MODEL,
    code: str | None = REFERENCE,
    **changes: Any,
) -> Path:
    """Write the adapter into a folder and return it.

    Args:
        folder: its name is the policy's.
        model_io: the block, None for none.
        model: text of model.py.
        code: text of reference.py, None for none.
        changes: keys of policy.yml.
    """
    answers = {**adapter.defaults(), "name": folder.name, "embodiment": "franka_single", "action_type": "joint"}
    adapter.write(adapter.render(AdapterAnswers(**answers)), folder, overwrite=True)
    (folder / "policy.yml").write_text(yaml.safe_dump(manifest(folder.name, model_io, **changes), sort_keys=False))
    (folder / "network.py").write_text(NETWORK)
    (folder / "model.py").write_text(model)
    if code is not None:
        (folder / "reference.py").write_text(code)
    return folder
