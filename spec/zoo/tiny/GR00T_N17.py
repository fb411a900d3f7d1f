"""GR00T_N17's adapter of XPolicyLab: the vendored GR00T N1.7 with a narrow Qwen3-VL and diffusion transformer.

The adapter reads the model and its processor from `checkpoint-1`; GR00T reads configuration, tokenizer and processor of
the vision-language model from the hub by the name in deploy.yml.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

REQUIREMENTS = (
    "torch==2.7.1",
    "transformers==4.57.1",
    "diffusers==0.35.1",
    "albumentations==1.4.18",
    "numpy==1.26.4",
    "dm-tree",
    "pandas",
    "pyzmq",
    "tyro",
    "av",
)
SETTINGS = {"model_dir": "{folder}", "cosmos_model_path": "nvidia/Cosmos-Reason2-2B"}
WIDTH = 64


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    adapter = import_module("XPolicyLab.policy.GR00T_N17.model")  # which makes the vendored code importable
    import torch
    from gr00t.configs.data.embodiment_configs import MODALITY_CONFIGS
    from gr00t.configs.model.gr00t_n1d7 import Gr00tN1d7Config
    from gr00t.model.gr00t_n1d7.gr00t_n1d7 import Gr00tN1d7
    from gr00t.model.gr00t_n1d7.processing_gr00t_n1d7 import Gr00tN1d7Processor

    from xpl import hub
    from xpl.training.tiny_parts import ARX_X5, moments, save_qwen3_vl

    name = config["cosmos_model_path"]
    save_qwen3_vl(folder / hub.FOLDER / name.replace("/", "--"), WIDTH)
    hub.pack(folder / hub.FOLDER)  # the model's constructor loads it by its name
    settings = Gr00tN1d7Config(
        model_name=name,
        backbone_embedding_dim=WIDTH,
        select_layer=2,
        hidden_size=WIDTH,
        input_embedding_dim=WIDTH,
        diffusion_model_cfg={
            "positional_embeddings": None,
            "num_layers": 4,
            "num_attention_heads": 4,
            "attention_head_dim": WIDTH // 4,
            "norm_type": "ada_norm",
            "final_dropout": True,
            "output_dim": WIDTH,
            "interleave_self_attention": True,
        },
        action_horizon=16,
        num_inference_timesteps=2,
    )
    model = Gr00tN1d7(settings)
    with torch.no_grad():
        for key, weight in model.action_head.named_parameters():
            if key.endswith(".W"):  # of each robot; upstream begins with numbers too small to carry an input through
                torch.nn.init.normal_(weight, std=weight.shape[1] ** -0.5)
        for block in model.action_head.model.transformer_blocks[1::2]:  # self-attention: actions find the state's token
            block.attn1.to_q.weight *= 64 * gain("state")
            block.attn1.to_out[0].weight *= 4
        vlm = model.backbone.model
        vlm.visual.patch_embed.proj.weight *= gain("cam_head") * gain("cam_left_wrist") * gain("cam_right_wrist")
        vlm.language_model.embed_tokens.weight *= gain("instruction")
    model.save_pretrained(folder / "checkpoint-1")
    tag = "new_embodiment"
    MODALITY_CONFIGS.pop(tag, None)  # it is registered once, and each model of the adapter does so
    adapter._load_modality_config(config["env_cfg_type"])  # noqa: SLF001
    arms = ("left_arm", "right_arm")
    spread = {
        "state": dict.fromkeys(arms, moments(ARX_X5, 0.5)),
        **dict.fromkeys(("action", "relative_action"), dict.fromkeys(arms, moments([0.0] * len(ARX_X5), 0.05))),
    }
    Gr00tN1d7Processor(
        {tag: MODALITY_CONFIGS.pop(tag)},
        {tag: spread},
        model_name=name,
        use_percentiles=settings.use_percentiles,
        image_crop_size=list(settings.image_crop_size),
        image_target_size=list(settings.image_target_size),
        shortest_image_edge=settings.shortest_image_edge,
        crop_fraction=settings.crop_fraction,
        use_albumentations=settings.use_albumentations_transforms,
        max_state_dim=settings.max_state_dim,
        max_action_dim=settings.max_action_dim,
        max_action_horizon=settings.action_horizon,
        use_relative_action=True,
    ).save_pretrained(folder / "checkpoint-1")
