"""Folders as trainings leave them behind: small, in their makers' formats, with numbers that can be told apart."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ALOHA = [f"{side}_{joint}" for side in ("left", "right") for joint in (*(f"joint{n}" for n in range(1, 7)), "gripper")]
"""Names of the numbers of a robot with two arms of six joints and a gripper each."""


def put(folder: Path, name: str, value: Any) -> Path:
    """Write one file below a folder: text as it is, anything else as JSON."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(value if isinstance(value, str) else json.dumps(value, indent=2), encoding="utf-8")
    return path


def safetensors(path: Path, tensors: Mapping[str, Sequence[float] | np.ndarray]) -> None:
    """Write a safetensors file: eight bytes with the length of a JSON header, the header, the numbers."""
    header, body = {}, b""
    for name, values in tensors.items():
        data = np.asarray(values, np.float32)
        header[name] = {
            "dtype": "F32",
            "shape": list(data.shape),
            "data_offsets": [len(body), len(body) + data.nbytes],
        }
        body += data.tobytes()
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + body)


def statistics(width: int, shift: float = 0.0) -> dict[str, list[float]]:
    """Return statistics of a vector, each number of which is another one."""
    low = [-0.5 - 0.01 * index + shift for index in range(width)]
    high = [0.5 + 0.02 * index + shift for index in range(width)]
    return {
        "min": low,
        "max": high,
        "mean": [(a + b) / 2 for a, b in zip(low, high, strict=True)],
        "std": [(b - a) / 4 for a, b in zip(low, high, strict=True)],
        "q01": [a + 0.05 for a in low],
        "q99": [b - 0.05 for b in high],
    }


COLOURS = {
    "mean": np.array([0.485, 0.456, 0.406]).reshape(3, 1, 1),
    "std": np.array([0.229, 0.224, 0.225]).reshape(3, 1, 1),
}
"""ImageNet's, in the shape that LeRobot keeps."""


def lerobot(
    folder: Path,
    kind: str = "act",
    *,
    width: int = 14,
    cameras: Mapping[str, tuple[int, int]] | None = None,
    modes: Mapping[str, str] | None = None,
    steps: Sequence[Mapping[str, Any]] = (),
    rename: Mapping[str, str] | None = None,
    **config: Any,
) -> Path:
    """Write a checkpoint as LeRobot's `save_pretrained` does, without its weights.

    Args:
        folder: where.
        kind: type of policy.
        width: numbers of state and action.
        cameras: name of an image to height and width.
        modes: normalisation by kind of feature.
        steps: further steps of the preprocessor, before the normalizer.
        rename: what the preprocessor renames.
        config: further keys of config.json.
    """
    cameras = {"observation.images.cam_high": (480, 640)} if cameras is None else cameras
    modes = modes or {"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"}
    images = {name: {"type": "VISUAL", "shape": [3, *size]} for name, size in cameras.items()}
    inputs = {"observation.state": {"type": "STATE", "shape": [width]}, **images}
    outputs = {"action": {"type": "ACTION", "shape": [width]}}
    put(
        folder,
        "config.json",
        {
            "type": kind,
            "n_obs_steps": 1,
            "input_features": inputs,
            "output_features": outputs,
            "normalization_mapping": dict(modes),
            **config,
        },
    )
    held = {"observation.state": statistics(width), "action": statistics(width, 0.1)}
    table = {f"{key}.{name}": values for key, numbers in held.items() for name, values in numbers.items()}
    table |= {f"{key}.{name}": values for key in images for name, values in COLOURS.items()}
    before = [
        {"registry_name": "rename_observations_processor", "config": {"rename_map": dict(rename or {})}},
        {"registry_name": "to_batch_processor", "config": {}},
        *map(dict, steps),
        _normalizer("normalizer_processor", {**inputs, **outputs}, modes, "policy_preprocessor", 2 + len(steps)),
    ]
    after = [_normalizer("unnormalizer_processor", outputs, modes, "policy_postprocessor", 0)]
    for name, listed in (("policy_preprocessor", before), ("policy_postprocessor", after)):
        put(folder, f"{name}.json", {"name": name, "steps": listed})
        safetensors(folder / next(step["state_file"] for step in listed if "state_file" in step), table)
    return folder


def _normalizer(name: str, features: Any, modes: Mapping[str, str], pipeline: str, place: int) -> dict[str, Any]:
    return {
        "registry_name": name,
        "config": {"eps": 1e-08, "features": features, "norm_map": dict(modes)},
        "state_file": f"{pipeline}_step_{place}_{name}.safetensors",
    }


def lerobot_dataset(
    folder: Path, names: Any = None, *, width: int = 14, robot: str = "aloha_agilex", fps: int = 30
) -> Path:
    """Write the `meta/` of a data set of LeRobot."""
    names = ALOHA if names is None else names
    features = {key: {"dtype": "float32", "shape": [width], "names": names} for key in ("observation.state", "action")}
    info = {"codebase_version": "v3.0", "robot_type": robot, "fps": fps, "features": features}
    put(folder, "meta/info.json", info)
    put(folder, "meta/stats.json", {"observation.state": statistics(width), "action": statistics(width, 0.1)})
    return folder
