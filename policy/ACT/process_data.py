"""Prepares a training: statistics and shapes of demonstrations, as LeRobot keeps them in a checkpoint."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.processor_act import make_act_pre_post_processors

from xpl import training
from xpl.trajectory import Folder, open_files, open_folder

STILL = 1e-4
"""What moves by less is taken for constant, as in Diffusion Policy: rounding must not become a signal."""


def demonstrations(config: dict[str, Any]) -> Folder:
    """Return the set, or the sets as one, that `demonstrations` of deploy.yml names."""
    given = config.get("demonstrations") or "../../demos"
    folders = [open_folder(Path(one).expanduser()) for one in ([given] if isinstance(given, str) else given)]
    return open_files([one.path for folder in folders for one in folder][: config.get("episodes")])


def place(config: dict[str, Any]) -> Path:
    """Return the checkpoint's folder, where model.py looks for it."""
    return Path(__file__).parent / "checkpoints" / str(config["run_name"] or config["ckpt_name"])


def main() -> None:
    """Write config.json and the processors with the numbers that `native.normalize` reads."""
    config = json.loads(os.environ["XPL_CONFIG"])
    settings = ACTConfig(**{**config["lerobot"], "device": "cpu", "push_to_hub": False})
    steps = settings.action_delta_indices
    package, found = Path(__file__).parent, demonstrations(config)
    numbers = training.statistics(package, config, found, horizon=len(steps), first=steps[0])
    policy = training.without_model(package, config, normalized=False)
    with found[0] as episode:
        policy.update_obs({**episode.observation(0), "env_idx": 0})
    inputs = policy.encodings(0)[-1]
    for image in policy.interface.images if policy.interface else ():
        _, _, mean, std = image.scaling
        numbers[image.name] = {"mean": mean, "std": std}
    settings.input_features = {name: PolicyFeature(_kind(name), np.shape(value)) for name, value in inputs.items()}
    settings.output_features = {"action": PolicyFeature(FeatureType.ACTION, numbers["action"]["mean"].shape)}
    told = {key: _torch(_still(value) if "min" in value else value) for key, value in numbers.items()}
    target = place(config)
    target.mkdir(parents=True, exist_ok=True)
    (target / ".training.pt").unlink(missing_ok=True)  # of a training on other numbers
    settings._save_pretrained(target)
    for pipeline in make_act_pre_post_processors(settings, dataset_stats=told):
        pipeline.save_pretrained(target)
    print(f"{len(found)} episodes, {int(numbers['action']['count'][0])} steps: {target}")


def _kind(name: str) -> FeatureType:
    if name.startswith("observation.images"):
        return FeatureType.VISUAL
    return FeatureType.ENV if name == "observation.environment_state" else FeatureType.STATE


def _still(numbers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    still = numbers["max"] - numbers["min"] < STILL
    changed: dict[str, Any] = {"std": 1.0, "min": numbers["mean"] - 1, "max": numbers["mean"] + 1}
    return {**numbers, **{key: np.where(still, value, numbers[key]) for key, value in changed.items()}}


def _torch(numbers: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    return {key: torch.as_tensor(np.asarray(value, np.float32)) for key, value in numbers.items()}


if __name__ == "__main__":
    main()
