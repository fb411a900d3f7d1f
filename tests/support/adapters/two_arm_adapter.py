"""Adapters with a model_io block for two arms and for one, of which tests look at what the model sees."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import yaml

from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers

if TYPE_CHECKING:
    from pathlib import Path

MODEL = """
import numpy as np
from xpl import Policy


class Model(Policy):
    def load(self, config):
        pass

    def predict(self, inputs, envs):
        return np.zeros((len(envs), 4, 16), np.float32)
"""


def image(name: str, camera: str, **more: Any) -> dict[str, Any]:
    """Return an image input of 64 x 64."""
    steps = [{"letterbox": {"to": [64, 64], "filter": "bilinear", "antialias": True}}]
    rest = {"channels": "rgb", "layout": "chw", "dtype": "float32", "range": [-1, 1]}
    return {"input": name, "cameras": [camera], "steps": steps, **rest, **more}


def _arm(side: str) -> list[dict[str, Any]]:
    return [{"joints": {"arm": side, "unit": "deg"}}, {"gripper": {"arm": side, "closed": 0.0, "open": 0.044}}]


def _span(low: float, high: float, gripper: float) -> dict[str, Any]:
    sides = {"min": [low] * 6 + [0.0], "max": [high] * 6 + [gripper]}
    return {"rule": "min_max", "values": {name: 2 * values for name, values in sides.items()}}


TWO_ARMS: dict[str, Any] = {
    "images": [
        image("top", "cam_head"),
        image("left_wrist", "cam_left_wrist"),
        image("right_wrist", "cam_right_wrist"),
    ],
    "state": [
        {
            "input": "state",
            "parts": [*_arm("left"), *_arm("right")],
            "normalize": _span(-200.0, 200.0, 0.05),
            "pad": 16,
        }
    ],
    "instruction": {"input": "prompt", "strip": " ", "case": "lower"},
    "action": {
        "reference": "delta_state",
        "parts": [*_arm("left"), *_arm("right")],
        "normalize": _span(-10.0, 10.0, 0.05),
        "pad": 16,
    },
}


def block(**changes: Any) -> dict[str, Any]:
    """Return the block for two arms with some of its keys changed."""
    return {**copy.deepcopy(TWO_ARMS), **changes}


def write_adapter(folder: Path, model_io: dict[str, Any] | None, model: str = MODEL) -> Path:
    """Write an adapter for two arms into a folder and return it."""
    answers = {**adapter.defaults(), "name": folder.name, "embodiment": "arx_x5", "action_type": "joint"}
    adapter.write(adapter.render(AdapterAnswers(**answers)), folder)
    manifest = yaml.safe_load((folder / "policy.yml").read_text(encoding="utf-8"))
    manifest.update({"spec": "v1", "temporal": {"kind": "chunk", "chunk": 4}})
    manifest.pop("model_io", None)
    manifest.update({} if model_io is None else {"model_io": model_io})
    (folder / "policy.yml").write_text(yaml.safe_dump(manifest, sort_keys=False), encoding="utf-8")
    (folder / "model.py").write_text(model, encoding="utf-8")
    return folder
