"""DM0's adapter of XPolicyLab: Dexbotic's DM0 with narrow Qwen3, action expert and SigLIP.

The adapter reads the newest `checkpoint-*` folder, or one with a config.json, and `norm_stats.json`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REQUIREMENTS = (
    "torch==2.7.1",
    "torchvision==0.22.1",
    "numpy==1.26.4",
    "transformers==4.57.0",
    "accelerate",
    "albumentations>=2.0.8",
    "datasets",
    "decord",
    "easydict",
    "flask",
    "loguru",
    "megfile",
)
SETTINGS = {"model_path": "{folder}"}
CUDA_ON_CPU = True

WIDTH, TOKENS, DIMS = 64, 320, 32
TOWER = "tiny/siglip"
"""Name of the vision tower in config.json, as of a repository of the hub."""
ARM = [0.0, 1.6, 1.5, 0.0, 0.0, 0.0]
SPECIAL = ("<|endoftext|>", "<|im_start|>", "<|im_end|>")


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    from dexbotic.model.dm0.dm0_arch import DM0Config, DM0ForCausalLM
    from transformers import Qwen2Tokenizer, SiglipImageProcessor, SiglipVisionConfig, SiglipVisionModel

    from xpl import hub

    tower = folder / hub.FOLDER / TOWER.replace("/", "--")
    shape = {"hidden_size": WIDTH, "intermediate_size": 128, "num_hidden_layers": 2, "num_attention_heads": 4}
    SiglipVisionModel(SiglipVisionConfig(**shape, image_size=112, patch_size=14)).save_pretrained(tower)
    SiglipImageProcessor(size={"height": 112, "width": 112}, image_mean=[0.5] * 3, image_std=[0.5] * 3).save_pretrained(
        tower
    )
    hub.pack(folder / hub.FOLDER)  # the model's constructor reads it by its name
    tokenizer(Qwen2Tokenizer, folder).save_pretrained(folder)
    language = {**shape, "model_type": "qwen3", "num_key_value_heads": 2, "head_dim": 16, "vocab_size": 512}
    settings = DM0Config(
        llm_config=language,
        action_config=language,
        mm_vision_tower=TOWER,
        mm_projector_type="mlp2x_gelu",
        action_dim=DIMS,
        chunk_size=int(config["action_chunk_size"]),
    )
    model = DM0ForCausalLM(settings)
    with torch.no_grad():
        inner = model.model
        inner.mm_vision_tower.vision_tower.vision_model.embeddings.patch_embedding.weight *= 4 * max(
            gain(f"cam_{name}") for name in ("head", "left_wrist", "right_wrist")
        )
        inner.llm.embed_tokens.weight *= 8 * gain("instruction")
        for layer in (*inner.llm.layers, *inner.action_expert.model.layers):
            layer.self_attn.q_norm.weight *= 3  # attention that depends on what a token is
            layer.self_attn.v_proj.weight *= 8
            layer.self_attn.o_proj.weight *= 8
        inner.action_out_proj.weight *= 4  # else the noise hides what the layers say
    model.save_pretrained(folder)
    state, change = [0.0] * DIMS, [0.0] * DIMS
    spread = {"state": [2.0] * DIMS, "action": [0.05] * DIMS}
    for base in (0, 14):  # an arm: six joints, the gripper, the pose
        state[base : base + 6] = ARM
        state[base + 6] = change[base + 6] = spread["state"][base + 6] = 0.5
        spread["action"][base + 6] = 0.1  # the noise, whatever it is, may not leave 0..1
    limits = {
        kind: {
            "min": [value - width for value, width in zip(middle, spread[kind], strict=True)],
            "max": [value + width for value, width in zip(middle, spread[kind], strict=True)],
        }
        for kind, middle in (("state", state), ("action", change))
    }
    (folder / "norm_stats.json").write_text(json.dumps({"norm_stats": limits}))


def tokenizer(kind: Any, folder: Path) -> Any:
    """Return a Qwen2 tokenizer of bytes, of this class."""
    from tokenizers.pre_tokenizers import ByteLevel

    (folder / "vocab.json").write_text(json.dumps({word: at for at, word in enumerate(sorted(ByteLevel.alphabet()))}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    names = {"pad_token": SPECIAL[0], "eos_token": SPECIAL[2], "additional_special_tokens": list(SPECIAL[1:])}
    return kind(str(folder / "vocab.json"), str(folder / "merges.txt"), **names, model_max_length=TOKENS)
