"""G05's adapter of XPolicyLab's fork: Galaxea's G0.5 with narrow towers of two layers, and its action codec.

The adapter reads a run's `.hydra/config.yaml`, `dataset_stats.json`, weights, `hf_processor` and action tokenizer.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REQUIREMENTS = (
    "torch==2.7.1",
    "torchvision==0.22.1",
    "numpy==1.26.4",
    "transformers==4.57.0",
    "accelerate",
    "einops",
    "gitpython",
    "hydra-core==1.3.2",
    "rootutils",
    "vit-pytorch==1.9.1",
    "opencv-python-headless<4.12",
)
SETTINGS = {"ckpt_path": "{folder}/checkpoints/step_1.pt", "action_source": "fm"}
CUDA_ON_CPU = True

WIDTH, WORDS = 64, 256
SPECIAL = [
    *("<|endoftext|>", "<|im_start|>", "<|im_end|>"),
    *("<|vision_start|>", "<|vision_end|>", "<|vision_pad|>", "<|image_pad|>", "<|video_pad|>"),
]
ARM, STEPS = [0.0, 1.6, 1.5, 0.0, 0.0, 0.0], 32


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    from hydra import compose, initialize_config_dir
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    root = Path.cwd() / "G05"
    sys.path[:0] = [str(root / "src"), str(root)]  # as the adapter does
    from g05.utils.checkpoint.ckpt_utils import load_config_from_run_dir
    from g05.utils.config.config_resolvers import register_default_resolvers

    register_default_resolvers()
    write_tokenizer(folder / "hf_processor")
    with initialize_config_dir(config_dir=str(root / "configs"), version_base="1.3"):
        settings = compose("train", ["task=robodojo_arx_x5_joint", "output_dir=.", "exp_name=tiny", "logger.task=tiny"])
    OmegaConf.set_struct(settings, value=False)
    settings.data.embodiment_datasets.robodojo.dataset_groups = []
    rope = {"mrope_section": [2, 1, 1]}
    layers = {"num_hidden_layers": 2, "num_attention_heads": 2, "num_key_value_heads": 1, "head_dim": 32}
    linear = {f"linear_{name}": 16 for name in ("key_head_dim", "value_head_dim")}
    linear |= {f"linear_num_{name}_heads": 2 for name in ("key", "value")}
    shape = {**layers, **linear, "linear_attn_backend": "torch", "rope_parameters": rope, "hidden_size": WIDTH}
    shape["intermediate_size"] = 2 * WIDTH
    special = {name: WORDS + at for at, name in enumerate(SPECIAL)}
    small = {
        "base_vocab_size": WORDS,
        "padded_vocab_size": WORDS + 32,
        "vocab_size": WORDS + 32,
        "pretrained_model_path": "none",  # so that the loader takes the run's own hf_processor
        "image_token_index": special["<|image_pad|>"],
        "pad_token_id": 0,
        "eos_token_id": WORDS,
        "vlm": {**shape, "layer_types": ["linear_attention", "full_attention"]},
        "action_expert": {**shape, "layer_types": ["full_attention"] * 2, "time_hidden_size": WIDTH},
        "fm": {"num_inference_steps": 2, "final_action_clip_value": 1.0},
        "ar": {"text_token_end": WORDS, "loc_token_end": WORDS + len(SPECIAL)},
        "vision": {
            "depth": 2,
            "hidden_size": WIDTH,
            "num_heads": 4,
            "intermediate_size": 2 * WIDTH,
            "out_hidden_size": WIDTH,
            "num_position_embeddings": 256,
        },
    }
    settings.model.model_arch = OmegaConf.merge(settings.model.model_arch, small)
    codec = {"encoder_channels": 16, "latent_dim": 16, "num_heads": 2, "dim_heads": 32, "codebook_size": 16}
    settings.tokenizer.vq_config.ckpt_dir = None
    settings.tokenizer.vq_config.model_arch = OmegaConf.merge(settings.tokenizer.vq_config.model_arch, codec)
    settings.model.tokenizer = settings.tokenizer
    (folder / ".hydra").mkdir()
    OmegaConf.save(settings, folder / ".hydra" / "config.yaml")
    os.chdir(root)  # as the adapter does: the configuration names files from there
    weights = folder / "checkpoints" / "step_1.pt"
    weights.parent.mkdir()
    loaded = load_config_from_run_dir(folder, str(weights), ["model.model_arch.discrete_action=false"])
    policy = instantiate(loaded.model.model_arch)
    scale(policy.model, gain)
    torch.save({"model_state_dict": policy.state_dict()}, weights)
    arm, gripper = spread(ARM, 0.1), spread([0.5], 0.2)
    parts = {"left_arm": arm, "left_gripper": gripper, "right_arm": arm, "right_gripper": gripper}
    stats = {
        "state": {key: {f"global_{name}": value for name, value in one.items()} for key, one in parts.items()},
        "action": {
            key: {
                **{f"global_{name}": value for name, value in one.items()},
                **{f"stepwise_{name}": [value] * STEPS for name, value in one.items()},
            }
            for key, one in parts.items()
        },
    }
    (folder / "dataset_stats.json").write_text(json.dumps({"robodojo": stats}))


def scale(model: Any, gain: Callable[[str], float]) -> None:
    """Scale the weights that read an input, and draw those that its authors begin with zeros."""
    import torch

    with torch.no_grad():
        model.vision_tower.patch_embed.proj.weight *= 8 * max(
            gain(f"cam_{name}") for name in ("head", "left_wrist", "right_wrist")
        )
        model.vlm.input_proj.weight *= gain("instruction")
        model.proprio_embedder.mlp[3].weight.normal_(std=0.1 * gain("state"))
        for name, layer in model.action_expert.named_modules():
            if name.endswith(".dense"):  # scales, shifts and gates, which its authors begin with zeros
                layer.bias.normal_(0.5, 0.2)
        for layer in (*model.vlm.layers, *model.action_expert.layers):
            if hasattr(layer, "self_attn"):  # attention that depends on what a token is
                layer.self_attn.q_norm.weight.fill_(3.0)
                layer.self_attn.v_proj.weight *= 4
        model.action_expert.output_proj.weight.normal_(std=0.2)


def spread(middle: list[float], deviation: float) -> dict[str, list[float]]:
    """Return statistics of a data set, in the form of the authors' training."""
    low, high = [value - 2 * deviation for value in middle], [value + 2 * deviation for value in middle]
    return {"mean": middle, "std": [deviation] * len(middle), "min": low, "max": high, "q01": low, "q99": high}


def write_tokenizer(folder: Path) -> None:
    """Write a tokenizer of bytes with Qwen's special tokens."""
    from tokenizers import AddedToken, Tokenizer, decoders, models
    from tokenizers.pre_tokenizers import ByteLevel

    folder.mkdir(parents=True)
    letters = Tokenizer(models.BPE({word: at for at, word in enumerate(sorted(ByteLevel.alphabet()))}, []))
    letters.pre_tokenizer = ByteLevel(add_prefix_space=False)
    letters.decoder = decoders.ByteLevel()
    letters.add_special_tokens([AddedToken(name, special=True) for name in SPECIAL])
    letters.save(str(folder / "tokenizer.json"))
    added = {str(WORDS + at): {"content": name, "special": True} for at, name in enumerate(SPECIAL)}
    images = {"image_token_id": "<|image_pad|>", "vision_start_token_id": SPECIAL[3], "vision_end_token_id": SPECIAL[4]}
    (folder / "config.json").write_text(json.dumps({key: letters.token_to_id(name) for key, name in images.items()}))
    names = {"eos_token": SPECIAL[0], "pad_token": SPECIAL[0]}
    (folder / "tokenizer_config.json").write_text(json.dumps({"added_tokens_decoder": added, **names}))
