"""Mem_0's adapter of XPolicyLab: the execution module on a narrow Qwen3-VL, and a diffusion transformer of two layers.

The adapter reads the weights of the executor, statistics and Qwen3-VL. Tasks of kind Mn ask a planning server: M1 here.
"""

from __future__ import annotations

import json
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
    "diffusers",
    "omegaconf",
    "openai",
    "termcolor",
    "opencv-python-headless<4.12",
)
SETTINGS = {
    "execution_ckpt": "{folder}/final_step1.pt",
    "state_stats_path": "{folder}/norm_stats.json",
    "task_type": "M1",
    "execution_module": {
        "qwen_vl": {"model_path": "{folder}/qwen", "system_prompt": None},
        "memory_bank": {
            "window_size": 30,
            "initial_anchor_size": 1,
            "num_heads": 8,
            "dropout": 0.1,
            "memory_accumulation": 8,
        },
        "action_model": {
            "action_model_type": "DiT-B",
            "hidden_size": 64,
            "add_pos_embed": True,
            "max_seq_len": 64,
            "action_dim": 16,
            "state_dim": 16,
            "action_horizon": 30,
            "repeated_diffusion_steps": 8,
            "noise_beta_alpha": 1.5,
            "noise_beta_beta": 1.0,
            "noise_s": 0.999,
            "num_timestep_buckets": 1000,
            "num_inference_timesteps": 2,
            "diffusion_model_cfg": {
                "cross_attention_dim": 64,
                "dropout": 0.2,
                "final_dropout": True,
                "interleave_self_attention": True,
                "norm_type": "ada_norm",
                "num_layers": 2,
                "output_dim": 64,
                "positional_embeddings": None,
            },
        },
        "classifier": {
            "hidden_sizes": [192, 64, 32],
            "dropout": 0.1,
            "pos_weight": 10.0,
            "focal_gamma": 1.0,
            "threshold": 0.5,
        },
        "loss_weights": {"lambda_action": 1.0, "lambda_classifier": 0.2},
    },
}
CUDA_ON_CPU = True

WIDTH = 64
SPECIAL = (
    "<|endoftext|>",
    "<|im_start|>",
    "<|im_end|>",
    "<|vision_start|>",
    "<|vision_end|>",
    "<|image_pad|>",
    "<|video_pad|>",
)
TEMPLATE = (
    "{% for message in messages %}<|im_start|>{{ message.role }}\n{% for part in message.content %}"
    "{% if part.type == 'image' %}<|vision_start|><|image_pad|><|vision_end|>{% else %}{{ part.text }}{% endif %}"
    "{% endfor %}<|im_end|>\n{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)
LOW, HIGH = [-0.5, 1.2, 1.0, -0.4, -0.4, -0.4, 0.0] * 2, [0.5, 2.0, 2.0, 0.4, 0.4, 0.4, 1.0] * 2
"""Of each joint of `arx_x5` and a number that is not used, in the order of the model."""


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    from omegaconf import OmegaConf

    write_vlm(folder / "qwen")
    sys.path.insert(0, str(Path.cwd() / "Mem_0"))  # as the adapter does
    from source.models.execution_module.memorymatters_executor import MemoryMattersExecutor

    settings = OmegaConf.create({"execution_module": dict(config["execution_module"])})
    executor = MemoryMattersExecutor(settings, device=torch.device("cpu"))
    with torch.no_grad():
        model = executor.qwen_model.model.model
        model.visual.patch_embed.proj.weight *= 4 * gain("cam_head")
        model.language_model.embed_tokens.weight *= 4 * gain("instruction")
        executor.action_model.state_encoder.layer1.weight *= gain("state")
        for block in executor.action_model.model.transformer_blocks:  # attention that depends on what a token is
            for layer in (block.attn1.to_q, block.attn1.to_k, block.attn1.to_v):
                layer.weight *= 6
        executor.action_model.action_decoder.layer2.weight *= 4  # else the noise hides what the layers say
    weights = {name: few(value) for name, value in executor.state_dict().items()}
    torch.save({"model_state_dict": weights}, folder / "final_step1.pt")
    limits = {f"{kind}_{name}": value for kind in ("state", "action") for name, value in (("min", LOW), ("max", HIGH))}
    (folder / "norm_stats.json").write_text(json.dumps(limits))


def few(value: Any) -> Any:
    """Return a matrix of the same shape and spread, whose numbers repeat so that its file is small."""
    import torch

    if value.ndim != 2 or value.numel() < 1 << 16:
        return value
    strides = (7, 3)
    reach = sum((size - 1) * stride for size, stride in zip(value.shape, strides, strict=True)) + 1
    numbers = value.reshape(-1)
    return torch.cat([numbers] * (reach // len(numbers) + 1))[:reach].clone().as_strided(value.shape, strides)


def write_vlm(folder: Path) -> None:
    """Write a Qwen3-VL with a tokenizer of bytes, and its processor."""
    from tokenizers.pre_tokenizers import ByteLevel
    from transformers import (
        Qwen2TokenizerFast,
        Qwen2VLImageProcessorFast,
        Qwen3VLConfig,
        Qwen3VLForConditionalGeneration,
        Qwen3VLProcessor,
        Qwen3VLVideoProcessor,
    )

    folder.mkdir(parents=True)
    words = sorted(ByteLevel.alphabet())
    (folder / "vocab.json").write_text(json.dumps({word: at for at, word in enumerate(words)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = Qwen2TokenizerFast(
        str(folder / "vocab.json"),
        str(folder / "merges.txt"),
        eos_token=SPECIAL[2],
        additional_special_tokens=list(SPECIAL[1:]),
    )
    sizes = {"size": {"shortest_edge": 16384, "longest_edge": 16384}, "patch_size": 16, "temporal_patch_size": 2}
    halves = {"image_mean": [0.5] * 3, "image_std": [0.5] * 3}
    Qwen3VLProcessor(
        Qwen2VLImageProcessorFast(**sizes, **halves), tokenizer, Qwen3VLVideoProcessor(**sizes, **halves), TEMPLATE
    ).save_pretrained(folder)
    first, last, image, video = tokenizer.convert_tokens_to_ids(SPECIAL[3:])
    shape = {"hidden_size": WIDTH, "intermediate_size": 2 * WIDTH, "initializer_range": WIDTH**-0.5}
    text = {
        **shape,
        "vocab_size": len(tokenizer),
        "num_hidden_layers": 2,
        "num_attention_heads": 4,
        "num_key_value_heads": 2,
        "head_dim": WIDTH // 4,
        "rope_scaling": {"rope_type": "default", "mrope_interleaved": True, "mrope_section": [4, 2, 2]},
    }
    vision = {
        **shape,
        "depth": 2,
        "num_heads": 4,
        "out_hidden_size": WIDTH,
        "num_position_embeddings": 256,
        "deepstack_visual_indexes": [0],
    }
    settings = Qwen3VLConfig(text, vision, image, video, first, last, tie_word_embeddings=True)
    Qwen3VLForConditionalGeneration(settings).save_pretrained(folder)
