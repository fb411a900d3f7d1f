"""InternVLA_A1_5's adapter of XPolicyLab: a Qwen3.5 of width 16 with its full vocabulary, and a narrow action expert.

The adapter reads config.json, model.safetensors and stats.json of a LeRobot checkpoint; the authors' code reads Qwen3.5
from the hub by name, and wants the numbers of its tokens for actions.
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
    "transformers==5.2.0",  # with the file of the authors' transformers_replace, as install.sh copies it
    "diffusers<0.36",
    "datasets>=4.0,<4.2",
    "draccus==0.10.0",
    "jsonlines",
    "deepdiff",
    "omegaconf",
    "loguru",
    "mediapy",
    "einops",
    "av",
)
SETTINGS = {"ckpt_path": "{folder}"}
VLM = "Qwen/Qwen3.5-2B"
WIDTH, HEAD = 16, 16
CAMERAS = ("cam_head", "cam_left_wrist", "cam_right_wrist")


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import_module("XPolicyLab.policy.InternVLA_A1_5.model")  # which makes the vendored code importable
    import torch
    from lerobot.policies.internvla_a1_5.configuration_internvla_a1_5 import InternVLAA15Config
    from lerobot.policies.internvla_a1_5.modeling_internvla_a1_5 import InternVLAA15Policy
    from safetensors.torch import load_file, save_file
    from transformers import Qwen3_5ForConditionalGeneration

    from xpl import hub
    from xpl.training.tiny_parts import enliven, moments

    words = processor(folder / hub.FOLDER / VLM.replace("/", "--"))
    network = Qwen3_5ForConditionalGeneration(_settings(words))
    weights = network.state_dict()
    few = {name: value for name, value in weights.items() if value.numel() < 2**16}  # the policy's file has them all
    network.save_pretrained(folder / hub.FOLDER / VLM.replace("/", "--"), state_dict=few)
    hub.pack(folder / hub.FOLDER)
    settings = InternVLAA15Config(
        vlm_model_name_or_path=VLM,
        action_expert_hidden_size=32,
        action_expert_intermediate_size=64,
        num_inference_steps=2,
        action_loss_only=True,
        dtype="float32",
        device="cpu",
        push_to_hub=False,
        wan_checkpoint_path="",
        wan_config_path="",
        vae_path="",
    )
    policy = InternVLAA15Policy(settings).eval()
    enliven(policy)
    qwen = policy.model.qwen3_5_with_expert.qwen3_5
    with torch.no_grad():
        for camera in CAMERAS:
            qwen.model.visual.patch_embed.proj.weight *= gain(camera)
        embeddings = qwen.get_input_embeddings().weight
        embeddings.normal_()
        for at, token in enumerate(words.convert_ids_to_tokens(range(256))):  # digits write the state
            embeddings[at] *= gain("state" if token.isdigit() else "instruction")
    policy.save_pretrained(folder)
    path = folder / "model.safetensors"
    save_file({name: value.to(torch.bfloat16) for name, value in load_file(path).items()}, path)
    spread = {
        "observation.state": moments([0.0] * 14, 0.5),
        "action": moments(([0.0] * 6 + [0.5]) * 2, 0.05),
    }
    (folder / "stats.json").write_text(json.dumps({config["stats_key"]: spread}))


def processor(folder: Path) -> Any:
    """Save a processor whose tokenizer has bytes, and fillers up to the tokens for actions; return the tokenizer."""
    from lerobot.policies.internvla_a1_5.action_tokens import ACTION_TOKEN_MIN
    from transformers import Qwen2VLImageProcessorFast, Qwen3_5Tokenizer, Qwen3VLProcessor, Qwen3VLVideoProcessor

    from xpl.training.tiny_parts import CHAT, QWEN, byte_vocabulary

    fillers = [f"<{at}>" for at in range(256, ACTION_TOKEN_MIN - len(QWEN))]
    words = Qwen3_5Tokenizer(
        vocab=byte_vocabulary(last=[*fillers, *QWEN]),
        merges=[],
        eos_token="<|im_end|>",  # noqa: S106
        pad_token="<|endoftext|>",  # noqa: S106
        extra_special_tokens=list(QWEN),
    )
    sizes = {"size": {"shortest_edge": 65536, "longest_edge": 16777216}, "patch_size": 16, "temporal_patch_size": 2}
    halves = {"image_mean": [0.5] * 3, "image_std": [0.5] * 3}
    images, videos = Qwen2VLImageProcessorFast(**sizes, **halves), Qwen3VLVideoProcessor(**sizes, **halves)
    Qwen3VLProcessor(images, words, videos, CHAT).save_pretrained(folder)
    return words


def _settings(words: Any) -> Any:
    """Return the configuration of a tiny Qwen3.5 for a tokenizer, with one layer of each kind of attention."""
    from transformers import Qwen3_5Config

    number = words.convert_tokens_to_ids
    common = {"hidden_size": WIDTH, "intermediate_size": 2 * WIDTH, "initializer_range": WIDTH**-0.5}
    rope = {"rope_type": "default", "rope_theta": 1e7, "partial_rotary_factor": 0.5}
    return Qwen3_5Config(
        text_config={
            **common,
            "vocab_size": len(words),
            "num_hidden_layers": 2,
            "layer_types": ["linear_attention", "full_attention"],
            "num_attention_heads": 2,
            "num_key_value_heads": 1,
            "head_dim": HEAD,
            "linear_key_head_dim": HEAD,
            "linear_value_head_dim": HEAD,
            "linear_num_key_heads": 2,
            "linear_num_value_heads": 2,
            "rope_parameters": {**rope, "mrope_section": [2, 1, 1], "mrope_interleaved": True},
            "tie_word_embeddings": True,
        },
        vision_config={
            **common,
            "depth": 1,
            "num_heads": 2,
            "out_hidden_size": WIDTH,
            "num_position_embeddings": 256,
        },
        image_token_id=number("<|image_pad|>"),
        video_token_id=number("<|video_pad|>"),
        vision_start_token_id=number("<|vision_start|>"),
        vision_end_token_id=number("<|vision_end|>"),
        tie_word_embeddings=True,
    )
