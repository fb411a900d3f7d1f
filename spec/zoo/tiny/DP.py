"""DP's adapter of XPolicyLab: its diffusion policy with a narrow U-Net, one convolution per camera and four steps.

The adapter reads the newest `NUMBER.ckpt` of the run's folder, which has the training's configuration in it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REQUIREMENTS = (
    "torch==2.7.1",
    "torchvision==0.22.1",
    "numpy==1.26.4",
    "hydra-core==1.3.2",
    "dill==0.4.0",
    "einops==0.8.1",
    "diffusers==0.33.1",
    "numba",
    "zarr==2.18.7",
    "opencv-python-headless",
)
SETTINGS = {"ckpt_path": "{folder}"}
CUDA_ON_CPU = True

LOW = [-0.5, 1.2, 1.0, -0.4, -0.4, -0.4, 0.1] * 2
HIGH = [0.5, 2.0, 2.0, 0.4, 0.4, 0.4, 0.9] * 2
"""Of each joint and gripper of `arx_x5`."""
CAMERAS = {"cam_head": "head_cam", "cam_left_wrist": "left_cam", "cam_right_wrist": "right_cam"}
VISION = {
    "_target_": "torch.nn.Sequential",
    "_args_": [
        {"_target_": "torch.nn.Conv2d", "in_channels": 3, "out_channels": 16, "kernel_size": 16, "stride": 16},
        {"_target_": "torch.nn.ReLU"},
        {"_target_": "torch.nn.AdaptiveAvgPool2d", "output_size": 2},
        {"_target_": "torch.nn.Flatten"},
    ],
}


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import numpy as np
    import torch

    sys.path.append(str(Path.cwd()))  # as the adapter does
    import diffusion_policy
    from diffusion_policy.common.normalize_util import get_image_range_normalizer
    from diffusion_policy.model.common.normalizer import LinearNormalizer
    from diffusion_policy.workspace.robotworkspace import RobotWorkspace
    from omegaconf import OmegaConf

    settings = Path(diffusion_policy.__file__).parent / "config"
    trained = OmegaConf.load(settings / "robot_dp.yaml")
    del trained["defaults"], trained["hydra"], trained["multi_run"], trained["logging"]
    trained.task = OmegaConf.load(settings / "task" / "default_task.yaml")
    trained = OmegaConf.merge(
        trained,
        {
            "task": {
                "shape_meta": {
                    "obs": {
                        **{name: {"shape": [3, 240, 320], "type": "rgb"} for name in CAMERAS.values()},
                        "agent_pos": {"shape": [len(LOW)], "type": "low_dim"},
                    },
                    "action": {"shape": [len(LOW)]},
                },
            },
            "policy": {"down_dims": [32, 64], "diffusion_step_embed_dim": 32, "num_inference_steps": 4},
            "training": {"use_ema": False},
        },
    )
    trained.policy.obs_encoder.rgb_model = VISION
    trained.policy.obs_encoder.use_group_norm = False
    OmegaConf.resolve(trained)
    workspace = RobotWorkspace(trained, output_dir=str(folder))
    normalizer = LinearNormalizer()
    limits = np.array([LOW, HIGH], np.float32)
    normalizer.fit({"action": limits, "agent_pos": limits})
    for name in CAMERAS.values():
        normalizer[name] = get_image_range_normalizer()
    workspace.model.set_normalizer(normalizer)
    encoder = workspace.model.obs_encoder
    with torch.no_grad():
        for camera, name in CAMERAS.items():
            encoder.key_model_map[name][0].weight *= 4 * gain(camera)
        for block in (one for one in workspace.model.model.modules() if hasattr(one, "cond_encoder")):
            read = block.cond_encoder[1].weight[:, 32:].unflatten(1, (trained.n_obs_steps, -1))  # behind the time
            read *= 4
            read[:, :-1] *= gain("history")
            read[..., -len(LOW) :] *= gain("state")
    workspace.save_checkpoint(folder / "600.ckpt", use_thread=False)
