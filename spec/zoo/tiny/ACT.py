"""ACT's adapter of XPolicyLab: the vendored DETR with one narrow layer each, and a ResNet-18 of few numbers.

The adapter reads `policy_last.ckpt` and `dataset_stats.pkl`; torchvision reads the ImageNet weights of its ResNet.
"""

from __future__ import annotations

import pickle
from argparse import Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REQUIREMENTS = ("torch==2.7.1", "torchvision==0.22.1", "numpy==1.26.4", "opencv-python-headless", "einops", "ipython")
SETTINGS = {
    "ckpt_dir": "{folder}",
    "action_dim": 14,
    "hidden_dim": 32,
    "dim_feedforward": 64,
    "nheads": 4,
    "enc_layers": 1,
    "dec_layers": 1,
}
VARIABLES = {"ACT_ACTION_DIM": "14", "TORCH_HOME": "{folder}/torch"}
CUDA_ON_CPU = True

MIDDLE = [0.0, 1.6, 1.5, 0.0, 0.0, 0.0, 0.5] * 2
"""Of each joint and gripper of `arx_x5`; spans are small, as random weights answer anything."""
IMAGENET = "torch/hub/checkpoints/resnet18-f37072fd.pth"


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import numpy as np
    import torch
    import torchvision

    path = folder / IMAGENET
    path.parent.mkdir(parents=True)
    torch.save({name: few(value) for name, value in torchvision.models.resnet18().state_dict().items()}, path)
    from .detr.act_policy import ACTPolicy

    policy = ACTPolicy(dict(config), Namespace(**config))
    with torch.no_grad():
        policy.model.input_proj_robot_state.weight *= 4 * gain("state")
        policy.model.input_proj.weight *= 4 * gain("cam_head") * gain("cam_left_wrist") * gain("cam_right_wrist")
    weights = {
        name: few(value) if ".backbones.0.0." in f".{name}" else value for name, value in policy.state_dict().items()
    }
    torch.save(weights, folder / "policy_last.ckpt")
    spread = {"mean": np.array(MIDDLE, np.float32), "std": np.full(len(MIDDLE), 0.05, np.float32)}
    stats = {f"{key}_{name}": value for key in ("qpos", "action") for name, value in spread.items()}
    (folder / "dataset_stats.pkl").write_bytes(pickle.dumps(stats))


def few(value: Any) -> Any:
    """Return a tensor of the same shape and spread whose numbers repeat, so that its file is small."""
    import torch

    if value.numel() < 1024:
        return value
    numbers = value.reshape(-1)[: value.shape[-1] * value.shape[-2] * 509].clone()
    strides = [7, 3, *([value.shape[-1], 1] if value.ndim == 4 else [])][-value.ndim :]
    reach = sum((size - 1) * stride for size, stride in zip(value.shape, strides, strict=True))
    repeated = torch.cat([numbers] * (reach // len(numbers) + 1))[: reach + 1].clone()
    return repeated.as_strided(value.shape, strides)
