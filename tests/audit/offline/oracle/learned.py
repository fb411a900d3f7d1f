"""Policies that are fitted to demonstrations, written as adapters with a native block, whole or with a mistake."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from xpl import get_embodiment, trajectory
from xpl.convert import compile_interface

HERE = Path(__file__).parent
ROBOT = "arx_x5"
_FEATURES = 64


@dataclass(frozen=True)
class Adapter:
    """One policy, as `adapters.yml` describes it.

    Attributes:
        name: of the policy and its package.
        told: what the file says: task, kind, chunk, action_type, native, pixels.
    """

    name: str
    told: dict[str, Any]

    def fit(self, episodes: list[trajectory.Trajectory]) -> dict[str, np.ndarray]:
        """Return the weights, of every second step of the episodes, through the right native block."""
        told, robot = self.told, get_embodiment(ROBOT)
        interface = compile_interface(told["native"], robot, told["action_type"], [], told["chunk"])
        inputs, answers = [], []
        for episode in episodes:
            actions = _commanded(episode, told["action_type"])
            seen = [episode.observation(step) for step in range(len(episode))]
            encoded = [interface.encode(obs) for obs in seen]
            for step in range(0, len(episode), 2):
                steps = [actions[min(step + ahead, len(actions) - 1)] for ahead in range(told["chunk"])]
                first = max(0, step - interface.span + 1)
                inputs.append(interface.batch([encoded[first : step + 1]]))
                answers.append(interface.action.encode(steps, seen[step]["state"], {}))
        return self._solved(inputs, np.stack(answers))

    def _solved(self, inputs: list[dict[str, Any]], answers: np.ndarray) -> dict[str, np.ndarray]:
        state = np.stack([one["state"][0].reshape(-1) for one in inputs]).astype(np.float64)
        weights = {
            "mean": state.mean(0),
            "std": state.std(0) + 0.05 * state.std(),
            "shape": np.array(answers.shape[1:]),
        }
        found = [(state - weights["mean"]) / weights["std"]]
        texts = sorted({one["prompt"][0] for one in inputs}) if "prompt" in inputs[0] else []
        if "image" in inputs[0]:
            pixels = np.stack([one["image"][0].reshape(-1) for one in inputs]).astype(np.float64)
            weights["pixels"] = pixels.mean(0)
            project = np.random.default_rng(3).standard_normal((pixels.shape[1], _FEATURES))
            seen = (pixels - weights["pixels"]) @ project
            weights["projection"] = project / seen.std() * float(self.told.get("pixels", 1.0))
            found.append((pixels - weights["pixels"]) @ weights["projection"])
        if texts:
            found.append(np.array([[4.0 * (one["prompt"][0] == text) for text in texts] for one in inputs]))
        features, flat = np.concatenate(found, axis=1), answers.reshape(len(answers), -1)
        weights["texts"] = np.array(texts, dtype=np.str_)
        if self.told["kind"] == "nearest":
            return {**weights, "rows": features, "answers": flat, "width": np.array(self.told.get("width", 1.5))}
        features = np.concatenate([features, np.ones((len(features), 1))], axis=1)
        squares = features.T @ features + 3.0 * np.eye(features.shape[1])
        ends = {"low": flat.min(0), "high": flat.max(0)}
        return {**weights, **ends, "matrix": np.linalg.solve(squares, features.T @ flat)}

    def write(self, folder: Path, weights: dict[str, np.ndarray], mistake: Mistake | None = None) -> Path:
        """Write the package into a new folder below `folder`, with a mistake if one is given, and return it."""
        package = folder / self.name
        package.mkdir(parents=True)
        shutil.copyfile(HERE / "adapter" / "model.py", package / "model.py")
        np.savez(package / "weights.npz", **weights)
        block = self.told["native"] if mistake is None else mistake.planted(self.told["native"])
        manifest = self._manifest(block)
        (package / "policy.yml").write_text(yaml.safe_dump(manifest, sort_keys=False))
        deploy = {"policy_name": self.name, "env_cfg_type": ROBOT, "action_type": self.told["action_type"], "seed": 0}
        (package / "deploy.yml").write_text(yaml.safe_dump(deploy))
        return package

    def _manifest(self, block: dict[str, Any]) -> dict[str, Any]:
        fields = {
            "joints": "arm_joint_state",
            "gripper": "ee_joint_state",
            "position": "ee_pose",
            "rotation": "ee_pose",
        }
        read = [f"state.{fields[kind]}" for entry in block["state"] for part in entry["parts"] for kind in part]
        if self.told["action_type"] == "ee":
            read.append("state.ee_pose")
        cameras = [camera for entry in block.get("images", []) for camera in entry["cameras"]]
        text = ["instruction"] if "instruction" in block else []
        return {
            "spec": "v1.2",
            "name": self.name,
            "summary": "Fitted to demonstrations.",
            "family": "other",
            "paper": None,
            "upstream": None,
            "license": "Apache-2.0",
            "temporal": {"kind": "chunk", "chunk": self.told["chunk"]},
            "control_frequency": None,
            "inputs": {
                "required": [*text, *dict.fromkeys(f"vision.{one}" for one in cameras), *dict.fromkeys(read)],
                "optional": [],
                "unused": [],
            },
            "cameras": {},
            "embodiments": [ROBOT],
            "action_types": [self.told["action_type"]],
            "gripper": {"command": "position"},
            "deterministic": True,
            "evaluation_only": True,
            "environment": {"manager": "none"},
            "native": block,
        }

    @cached_property
    def mistakes(self) -> list[Mistake]:
        """The mistakes that are planted into it."""
        told = yaml.safe_load((HERE / "mistakes.yml").read_text())[self.name]
        return [Mistake(name, listed(one["convention"]), one["edits"]) for name, one in told.items()]


@dataclass(frozen=True)
class Mistake:
    """A change of a right native block.

    Attributes:
        name: in a few words.
        conventions: any of them names the cause right.
        edits: by place in the block, keys joined by `/`, the new value; null takes it out.
        replace: in a file of the package, what stands for what: `file`, `old`, `new`.
    """

    name: str
    conventions: tuple[str, ...]
    edits: dict[str, Any]
    replace: dict[str, str] | None = None

    def planted(self, block: dict[str, Any]) -> dict[str, Any]:
        """Return the block with the mistake."""
        result = json.loads(json.dumps(block))  # places that YAML's aliases share are places of their own
        for place, value in self.edits.items():
            *way, last = [int(key) if key.isdigit() else key for key in place.split("/")]
            spot: Any = result
            for key in way:
                spot = spot[key]
            if value is None:
                del spot[last]
            else:
                spot[last] = value
        return result


def adapters(names: list[str] | None = None) -> list[Adapter]:
    """Return the policies of `adapters.yml`, those of some names or all."""
    told = yaml.safe_load((HERE / "adapters.yml").read_text())
    return [Adapter(name, one) for name, one in told.items() if not names or name in names]


def _commanded(episode: trajectory.Trajectory, action_type: str) -> list[dict[str, Any]]:
    from xpl_cli.audit.offline.demonstrations.episodes import recording

    found = recording(episode, get_embodiment(ROBOT), action_type).commanded
    return [{key: rows[step] for key, rows in found.items()} for step in range(len(episode))]


def listed(told: Any) -> tuple[str, ...]:
    """Return the conventions of which any names a cause right."""
    return (told,) if isinstance(told, str) else tuple(told)
