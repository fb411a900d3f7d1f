"""LatentToM's adapter of a fork of XPolicyLab: a diffusion policy with a narrow U-Net for each arm.

The adapter reads `checkpoints/arm1_latest.ckpt` and `arm2_latest.ckpt` with the authors' configuration. The widths of
its ResNet-18 are fixed: its large tensors are of few numbers. `arx_x5` stands for the fork's pairs of humanoids.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

REQUIREMENTS = ("torch==2.4.1", "torchvision==0.19.1", "diffusers==0.11.1", "hydra-core==1.2.0", "dill==0.3.5.1")
SETTINGS = {"ckpt_name": "{folder}", "env_cfg_type": "arx_x5"}
PROPRIO, ACTION, IMAGE = 43, 35, [3, 240, 320]
CAMERAS = {"camera_1": "cam_left_wrist", "camera_3": "cam_head", "camera_4": "cam_right_wrist"}


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import_module("XPolicyLab.policy.LatentToM.model")  # makes the authors' code importable
    import dill
    import hydra
    import torch
    from diffusion_policy.common.normalize_util import get_image_range_normalizer
    from diffusion_policy.model.common.normalizer import SingleFieldLinearNormalizer
    from omegaconf import OmegaConf

    from xpl.training.tiny_parts import enliven, few

    settings = OmegaConf.create({"policy": _policy()})
    (folder / "checkpoints").mkdir()
    for arm in (1, 2):
        policy = hydra.utils.instantiate(settings.policy).eval()
        enliven(policy.model)
        for camera in CAMERAS:
            policy.normalizer[camera] = get_image_range_normalizer()
        for name, width, half in (("proprio", PROPRIO, 1.0), ("action", ACTION, 0.5)):
            low, high = -half * torch.ones(width), half * torch.ones(width)
            spread = {"min": low, "max": high, "mean": 0 * high, "std": high / 2}
            linear = SingleFieldLinearNormalizer.create_manual(1 / high, 0 * high, spread)
            policy.normalizer[f"arm{arm}_{name}"] = linear
        weights = policy.state_dict()
        for camera, name in CAMERAS.items():
            weights[f"obs_encoder.key_model_map.{camera}.conv1.weight"] *= gain(name)
        states = {
            f"arm{arm}_ema_model": {name: few(weight) for name, weight in weights.items()},
            f"arm{arm}_model": {name: few(weight) for name, weight in weights.items()},  # of other numbers
        }
        saved = {"cfg": settings, "state_dicts": states, "pickles": {}}
        torch.save(saved, folder / "checkpoints" / f"arm{arm}_latest.ckpt", pickle_module=dill)


def _policy() -> dict[str, Any]:
    """Return the authors' configuration of the policy with a narrow U-Net and few steps of denoising."""
    rgb = {"shape": IMAGE, "type": "rgb"}
    shapes = {
        "obs": {
            **dict.fromkeys(CAMERAS, rgb),
            **{f"arm{arm}_proprio": {"shape": [PROPRIO], "type": "low_dim"} for arm in (1, 2)},
        },
        **{f"arm{arm}_action": {"shape": [ACTION]} for arm in (1, 2)},
    }
    return {
        "_target_": "diffusion_policy.policy.diffusion_sheaf_split_policy.DiffusionSheafSplitPolicy",
        "shape_meta": shapes,
        "noise_scheduler": {
            "_target_": "diffusers.schedulers.scheduling_ddim.DDIMScheduler",
            "num_train_timesteps": 100,
            "beta_start": 0.0001,
            "beta_end": 0.02,
            "beta_schedule": "squaredcos_cap_v2",
            "clip_sample": True,
            "set_alpha_to_one": True,
            "steps_offset": 0,
            "prediction_type": "epsilon",
        },
        "obs_encoder": {
            "_target_": "diffusion_policy.model.vision.sheaf_obs_encoder.SheafObsEncoder",
            "shape_meta": shapes,
            "rgb_model": {
                "_target_": "diffusion_policy.model.vision.model_getter.get_resnet",
                "name": "resnet18",
                "weights": None,
            },
            "resize_shape": [60, 80],
            "crop_shape": [54, 72],
            "random_crop": True,
            "use_group_norm": True,
            "share_rgb_model": False,
            "imagenet_norm": True,
        },
        "horizon": 40,
        "n_action_steps": 20,
        "n_obs_steps": 2,
        "num_inference_steps": 2,
        "obs_as_global_cond": True,
        "diffusion_step_embed_dim": 32,
        "down_dims": [16, 32, 64],
        "kernel_size": 5,
        "n_groups": 8,
        "cond_predict_scale": True,
    }
