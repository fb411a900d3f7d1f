"""Tiny random checkpoint of SmolVLA: a SmolVLM of two layers, and the expert of as many."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .parts import byte_vocabulary, enliven, features, offer, statistics
from .simulators import VARIANTS

VLM = "HuggingFaceTB/SmolVLM2-500M-Video-Instruct"
SPECIAL = ("<|endoftext|>", "<pad>", "<image>", "<fake_token_around_image>", "<global-img>", "<end_of_utterance>")
OWN = 8
"""Channels that the token of the state has for itself, so that a gain reaches it among the other tokens."""


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
    from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy

    from xpl.training import tiny_lerobot

    offer(folder, VLM, *_vlm())
    data = VARIANTS.get(config.get("variant") or "")
    settings = SmolVLAConfig(
        **(data.features() if data else features()),
        vlm_model_name=VLM,
        resize_imgs_with_padding=(64, 64),
        num_vlm_layers=2,
        expert_width_multiplier=0.5,
        chunk_size=8,
        n_action_steps=8,
        num_steps=2,
        max_state_dim=8,
        max_action_dim=8,
    )
    policy = SmolVLAPolicy(settings).eval()
    with torch.no_grad():
        enliven(policy.model.vlm_with_expert)
        vlm = policy.model.vlm_with_expert.get_vlm_model()
        vlm.text_model.embed_tokens.weight[:, :OWN] = 0
        vlm.connector.modality_projection.proj.weight[:OWN] = 0
        for layer in vlm.text_model.layers:
            layer.self_attn.v_proj.weight[:, :OWN] *= 4 * gain("state")
        vlm.connector.modality_projection.proj.weight *= gain("cam_head") * gain("cam_wrist")
        vlm.text_model.embed_tokens.weight *= gain("instruction")
    tiny_lerobot.save(folder, policy, data.statistics() if data else statistics())


def _vlm() -> tuple[Any, Any]:
    """Return the processor and the configuration of the VLM, of which SmolVLA's checkpoints hold the weights alone."""
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers
    from transformers import (
        PreTrainedTokenizerFast,
        SmolVLMConfig,
        SmolVLMImageProcessor,
        SmolVLMProcessor,
        SmolVLMVideoProcessor,
    )

    vocabulary = byte_vocabulary(first=SPECIAL)
    tokenizer = Tokenizer(models.BPE(vocab=vocabulary, merges=[]))
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    end, pad, image, fake, whole, utterance = SPECIAL
    names = {
        "image_token": image,
        "fake_image_token": fake,
        "global_image_token": whole,
        "end_of_utterance_token": utterance,
    }
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, bos_token=end, eos_token=utterance, pad_token=pad, extra_special_tokens=names
    )
    text = {
        "model_type": "llama",
        "hidden_size": 64,
        "intermediate_size": 128,
        "num_hidden_layers": 2,
        "num_attention_heads": 4,
        "num_key_value_heads": 2,
        "head_dim": 16,
        "vocab_size": len(vocabulary),
        "pad_token_id": vocabulary[pad],
    }
    vision = {
        "hidden_size": 32,
        "intermediate_size": 64,
        "num_hidden_layers": 1,
        "num_attention_heads": 2,
        "image_size": 64,
        "patch_size": 16,
    }
    settings = SmolVLMConfig(
        text_config=text,
        vision_config=vision,
        scale_factor=2,
        image_token_id=vocabulary[image],
        pad_token_id=vocabulary[pad],
    )
    return SmolVLMProcessor(SmolVLMImageProcessor(), fast, SmolVLMVideoProcessor()), settings
