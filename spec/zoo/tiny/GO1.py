"""GO1's adapter of XPolicyLab: the vendored GO-1 with two narrow layers of each network and images of 112 pixels.

The adapter reads a model and InternLM2's tokenizer, with its code, from a checkpoint's folder, and dataset_stats.json
beside it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

REQUIREMENTS = (
    "torch==2.7.1",
    "torchvision==0.22.1",
    "transformers==4.46.3",
    "diffusers==0.32.2",
    "timm",
    "draccus",
    "einops",
    "fastapi",
    "uvicorn",
    "json_numpy",
    "decord",
    "imageio",
    "sentencepiece",
    "protobuf",
    "numpy<2",
)
SETTINGS = {"ckpt_name": "{folder}"}
WIDTH, LAYERS, SIZE, PATCH = 64, 2, 112, 14
SPECIAL = ("<|im_start|>", "<|im_end|>", "<img>", "</img>", "<IMG_CONTEXT>")


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import_module("XPolicyLab.policy.GO1.model")  # which makes the vendored code importable
    import torch
    from go1.internvl.model.go1 import GO1Model, GO1ModelConfig

    from xpl.training.tiny_parts import ARX_X5, enliven, moments

    checkpoint = folder / "checkpoint-1"
    words = tokenizer(checkpoint)
    heads = {"num_attention_heads": 4, "num_key_value_heads": 2}
    size = {"hidden_size": WIDTH, "intermediate_size": 2 * WIDTH, "num_hidden_layers": LAYERS}
    expert = {**size, **heads, "hidden_size": WIDTH // 2, "input_hidden_size": WIDTH}
    vision = {**size, "num_attention_heads": 4, "patch_size": PATCH, "image_size": SIZE, "use_flash_attn": False}
    numbers = len(ARX_X5) * 2
    settings = GO1ModelConfig(
        vision_config={**vision, "norm_type": "layer_norm", "qk_normalization": False, "qkv_bias": True},
        llm_config={**size, **heads, "architectures": ["InternLM2ForCausalLM"], "vocab_size": len(words)},
        action_config={
            **expert,
            "architectures": ["ActionExpertModel"],
            "state_dim": numbers,
            "action_dim": numbers,
            "action_chunk_size": config["action_chunk_size"],
        },
        latent_planner_config={**expert, "architectures": ["ActionExpertModel"], "head_dim": WIDTH // 8},
        noise_scheduler_config={
            "num_train_timesteps": 1000,
            "num_inference_timesteps": 2,
            "beta_schedule": "squaredcos_cap_v2",
            "prediction_type": "sample",
            "clip_sample": False,
        },
        template="internlm2-chat",
        force_image_size=SIZE,
        img_context_token_id=words.convert_tokens_to_ids("<IMG_CONTEXT>"),
        pad_token_id=words.pad_token_id,
        ps_version="v2",
        latent_planning=True,
        norm=True,
        torch_dtype="bfloat16",
    )
    model = GO1Model(settings).float()
    enliven(model)
    with torch.no_grad():
        model.vision_model.embeddings.patch_embedding.weight *= gain("cam_head") * gain("cam_left_wrist")
        model.language_model.get_input_embeddings().weight.normal_().mul_(gain("instruction"))
        model.state_adaptor[0].weight *= gain("state")
    model.to(torch.bfloat16).save_pretrained(checkpoint)
    spread = {"state": moments(ARX_X5 * 2, 0.5), "action": moments(ARX_X5 * 2, 0.1)}
    (folder / "dataset_stats.json").write_text(json.dumps(spread))


def tokenizer(folder: Path) -> Any:
    """Save a tokenizer of InternLM2 with single letters for tokens, and its code, in the checkpoint; return it."""
    import sentencepiece
    from go1.internvl.model.internlm2.tokenization_internlm2 import InternLM2Tokenizer

    folder.mkdir()
    sentencepiece.SentencePieceTrainer.train(
        sentence_iterator=iter(["abcdefghijklmnopqrstuvwxyz", "ABCDEFGHIJKLMNOPQRSTUVWXYZ", "0123456789 .,?'"]),
        model_prefix=str(folder / "words"),
        model_type="char",
        vocab_size=72,
        hard_vocab_limit=False,
        minloglevel=2,
    )
    InternLM2Tokenizer.register_for_auto_class()
    words = InternLM2Tokenizer(
        str(folder / "words.model"),
        pad_token="</s>",  # noqa: S106
        add_bos_token=True,
        additional_special_tokens=list(SPECIAL),
    )
    words.save_pretrained(folder)
    for path in folder.glob("words.*"):
        path.unlink()
    return words
