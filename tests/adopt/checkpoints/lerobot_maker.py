"""Makes a small policy with random weights by LeRobot itself, and saves it as its training does.

    python lerobot_maker.py act|diffusion FOLDER

It runs in a Python that has LeRobot. Statistics keep what the policy answers within the limits of `aloha_agilex`.
"""

import sys

import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

CAMERAS = ("observation.images.cam_high", "observation.images.cam_left_wrist")
MIDDLE = [0.0, 1.6, 1.5, 0.0, 0.0, 0.0, 0.5] * 2
"""Of each joint and gripper; spans are small, as a network without training answers anything."""


def main(kind: str, folder: str) -> None:
    """Save policy and processors."""
    torch.manual_seed(7)
    images = {name: PolicyFeature(type=FeatureType.VISUAL, shape=(3, 96, 128)) for name in CAMERAS}
    inputs = {"observation.state": PolicyFeature(type=FeatureType.STATE, shape=(14,)), **images}
    shared = {
        "input_features": inputs,
        "output_features": {"action": PolicyFeature(type=FeatureType.ACTION, shape=(14,))},
        "pretrained_backbone_weights": None,
        "device": "cpu",
    }
    small = {"dim_model": 32, "n_heads": 2, "dim_feedforward": 32, "n_encoder_layers": 1, "n_vae_encoder_layers": 1}
    config = {
        "act": lambda: ACTConfig(**shared, **small, chunk_size=8, n_action_steps=6),
        "diffusion": lambda: DiffusionConfig(
            **shared,
            horizon=16,
            n_action_steps=8,
            down_dims=(16, 32),
            diffusion_step_embed_dim=16,
            num_train_timesteps=4,
        ),
    }[kind]()
    policy = get_policy_class(config.type)(config)
    middle = torch.tensor(MIDDLE)
    numbers = {"min": middle - 0.05, "max": middle + 0.07, "mean": middle + 0.01, "std": torch.full((14,), 0.03)}
    eye = {"mean": torch.tensor([0.485, 0.456, 0.406]), "std": torch.tensor([0.229, 0.224, 0.225])}
    shown = {name: value.reshape(3, 1, 1) for name, value in eye.items()}
    stats = {"observation.state": numbers, "action": numbers, **dict.fromkeys(CAMERAS, shown)}
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    for part in (policy, before, after):
        part.save_pretrained(folder)


if __name__ == "__main__":
    main(*sys.argv[1:])
