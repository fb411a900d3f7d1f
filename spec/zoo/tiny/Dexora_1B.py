"""Dexora-1B's adapter of XPolicyLab: narrow RDT, SigLIP and T5 of their own classes; RDT's of Dexora's repository.

The adapter needs a checkout of it (`dexora_root`, or DEXORA_ROOT), and reads weights, configuration and statistics.
"""

from __future__ import annotations

import json
import os
import string
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

REQUIREMENTS = (
    "torch==2.7.1",
    "torchvision==0.22.1",
    "numpy==1.26.4",
    "transformers==4.41.0",
    "diffusers==0.27.2",
    "timm==1.0.3",
    "h5py",
    "opencv-python-headless<4.12",
)
SETTINGS = {
    "checkpoint_path": "{folder}/model.safetensors",
    "config_path": "{folder}/base.yaml",
    "stats_file": "{folder}/stats.json",
}
CUDA_ON_CPU = True

WIDTH, IMAGE, PATCH, TOKENS, STEPS = 64, 56, 14, 1024, 32
LOW = [-0.5, 1.2, 1.0, -0.4, -0.4, -0.4, 0.0] * 2
HIGH = [0.5, 2.0, 2.0, 0.4, 0.4, 0.4, 1.0] * 2
"""Of each joint and gripper of `arx_x5`."""


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import torch
    import yaml
    from safetensors.torch import save_model
    from transformers import SiglipImageProcessor, SiglipVisionConfig, SiglipVisionModel, T5Config, T5EncoderModel

    vision, text = folder / "hub/google--siglip-so400m-patch14-384", folder / "hub/google--t5-v1_1-xxl"
    sys.path.insert(0, str(config.get("dexora_root") or os.environ["DEXORA_ROOT"]))  # as the adapter does
    from models.rdt_runner import RDTRunner

    shape = {"hidden_size": WIDTH, "intermediate_size": 128, "num_hidden_layers": 1, "num_attention_heads": 4}
    SiglipVisionModel(SiglipVisionConfig(**shape, image_size=IMAGE, patch_size=PATCH)).save_pretrained(vision)
    SiglipImageProcessor(  # as of siglip-so400m-patch14-384, but for the size
        size={"height": IMAGE, "width": IMAGE}, resample=3, image_mean=[0.5] * 3, image_std=[0.5] * 3
    ).save_pretrained(vision)
    words = tokenizer()
    words.save_pretrained(text)
    sizes = {"d_model": WIDTH, "d_kv": 16, "d_ff": 128, "num_layers": 1, "num_heads": 4}
    T5EncoderModel(T5Config(len(words), **sizes, feed_forward_proj="gated-gelu")).save_pretrained(text)
    dims = {"lang_token_dim": WIDTH, "img_token_dim": WIDTH, "state_token_dim": len(LOW)}
    settings = {
        "common": {"img_history_size": 1, "action_chunk_size": STEPS, "num_cameras": 3, "state_dim": len(LOW)},
        "dataset": {"tokenizer_max_length": TOKENS},
        "model": {
            **dims,
            "lang_adaptor": "mlp2x_gelu",
            "img_adaptor": "mlp2x_gelu",
            "state_adaptor": "mlp3x_gelu",
            "rdt": {"hidden_size": WIDTH, "depth": 2, "num_heads": 4, "cond_pos_embed_type": "multimodal"},
            "noise_scheduler": {
                "type": "ddpm",
                "num_train_timesteps": 1000,
                "num_inference_timesteps": 2,
                "beta_schedule": "squaredcos_cap_v2",
                "prediction_type": "sample",
                "clip_sample": False,
            },
        },
    }
    (folder / "base.yaml").write_text(yaml.safe_dump(settings))
    patches = (IMAGE // PATCH) ** 2
    policy = RDTRunner(
        action_dim=len(LOW),
        pred_horizon=STEPS,
        config=settings["model"],
        **dims,
        max_lang_cond_len=TOKENS,
        img_cond_len=3 * patches,
        lang_pos_embed_config=[("lang", -TOKENS)],
        img_pos_embed_config=[("image", (1, 3, -patches))],
        dtype=torch.float32,
    )
    with torch.no_grad():
        last = policy.model.final_layer.ffn_final.fc2  # its authors begin with zeros
        last.weight.normal_(std=0.05)
        last.bias.fill_(0.5)  # in the middle of the statistics
        policy.model.blocks[0].attn.proj.weight *= gain("state")
        policy.lang_adaptor[-1].weight *= gain("instruction")
        policy.img_adaptor[-1].weight *= max(gain(f"cam_{name}") for name in ("head", "left_wrist", "right_wrist"))
    save_model(policy, str(folder / "model.safetensors"))
    limits = {"percentile_1": LOW, "percentile_99": HIGH}
    (folder / "stats.json").write_text(json.dumps({"state": limits, "action": limits}))


def tokenizer() -> Any:
    """Return a tokenizer of T5's class whose pieces are single characters."""
    from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers, processors
    from transformers import T5TokenizerFast

    pieces = ["<pad>", "</s>", "<unk>", "\u2581", *string.ascii_letters, *string.digits, *string.punctuation]
    words = Tokenizer(models.Unigram([(piece, 0.0 if rank < 3 else -2.0) for rank, piece in enumerate(pieces)], 2))
    words.normalizer = normalizers.Sequence([normalizers.NFKC(), normalizers.Replace(Regex(" {2,}"), " ")])
    words.pre_tokenizer = pre_tokenizers.Metaspace()
    words.post_processor = processors.TemplateProcessing("$A </s>", special_tokens=[("</s>", 1)])
    return T5TokenizerFast(tokenizer_object=words, extra_ids=0)
