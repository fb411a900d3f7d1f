"""Tiny random checkpoint of ACT."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .parts import features, statistics
from .simulators import VARIANTS


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy

    from xpl.training import tiny_lerobot

    data = VARIANTS.get(config.get("variant") or "")
    chunk = 100 if data else 16
    settings = ACTConfig(
        **(data.features() if data else features(96, 96)),
        chunk_size=chunk,
        n_action_steps=chunk,
        pretrained_backbone_weights=None,
        dim_model=64,
        n_heads=4,
        dim_feedforward=128,
        n_encoder_layers=1,
        use_vae=False,
    )
    policy = ACTPolicy(settings).eval()
    with torch.no_grad():
        policy.model.encoder_robot_state_input_proj.weight *= gain("state")
        policy.model.encoder_img_feat_input_proj.weight *= gain("cam_head") * gain("cam_wrist")
    tiny_lerobot.save(folder, policy, data.statistics() if data else statistics())
