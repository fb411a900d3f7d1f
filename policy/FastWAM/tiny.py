"""Tiny random checkpoint: FastWAM, and Wan's VAE, text encoder and tokenizer, with shrunken configurations."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

WIDTH = 48
WAN = "wan"
"""Folder that policy.yml names by DIFFSYNTH_MODEL_BASE_PATH."""
FILES = "DiffSynth-Studio/Wan-Series-Converted-Safetensors"
TEXT_ENCODER, VAE, TOKENIZER = "models_t5_umt5-xxl-enc-bf16", "Wan2.2_VAE", "Wan-AI/Wan2.1-T2V-1.3B/google/umt5-xxl"
SIZES = {"hidden_dim": WIDTH, "ffn_dim": 2 * WIDTH, "freq_dim": 32, "text_dim": WIDTH, "num_heads": 2, "num_layers": 2}
LOW = {"state": [-1.0, -1.0, -1.0, -6.3, -6.3, -6.3, -0.01, -0.05], "action": [-0.94] * 3 + [-0.3] * 3 + [0.0]}
HIGH = {"state": [1.0, 1.0, 2.0, 6.3, 6.3, 6.3, 0.05, 0.01], "action": [0.94] * 3 + [0.3] * 3 + [1.0]}


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import os

    import fastwam
    import torch
    from fastwam.utils.config_resolvers import register_default_resolvers
    from hydra import compose, initialize_config_dir
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    os.environ["DIFFSYNTH_MODEL_BASE_PATH"] = str(folder / WAN)
    write_wan(folder / WAN, gain)
    sizes = {**SIZES, "attn_head_dim": WIDTH // 2}
    own = {
        "model": {"video_dit_config": sizes, "action_dit_config": sizes},
        "EVALUATION": {"num_inference_steps": 2},
    }
    OmegaConf.save(OmegaConf.create(own), folder / "config.yaml")
    register_default_resolvers()
    with initialize_config_dir(str(Path(fastwam.__file__).parents[2] / "configs"), version_base="1.3"):
        settings = OmegaConf.merge(compose(config["hydra_config"]), own)
    model = instantiate(settings.model, model_dtype=torch.float32, device="cpu")
    with torch.no_grad():
        model.proprio_encoder.weight *= 8 * gain("state")
        model.action_expert.head.weight *= 8  # else the noise hides what the layers say
        for block in model.action_expert.blocks:  # sharp attention: one token among a hundred counts
            for layer in (block.self_attn, block.cross_attn):
                layer.norm_q.weight *= 8
                layer.o.weight *= 8
    model.save_checkpoint(folder / config["weights"])
    statistics = {
        kind: {"default": {"global_min": LOW[kind], "global_max": HIGH[kind]}} for kind in ("state", "action")
    }
    (folder / config["statistics"]).write_text(json.dumps(statistics))


def write_wan(folder: Path, gain: Callable[[str], float]) -> None:
    """Write Wan's text encoder and VAE, each with its sizes beside it, and a tokenizer of letters and the prompt."""
    import string

    import torch
    from fastwam.datasets.lerobot.robot_video_dataset import DEFAULT_PROMPT
    from fastwam.models.wan22.wan_video_text_encoder import WanTextEncoder
    from fastwam.models.wan22.wan_video_vae import WanVideoVAE38
    from safetensors.torch import save_file
    from tokenizers import Tokenizer, models, pre_tokenizers, processors
    from transformers import T5TokenizerFast

    letters = ["▁", *string.ascii_letters, *string.digits, *string.punctuation]
    pieces = {"<pad>": 0.0, "</s>": 0.0, "<unk>": -9.0, **dict.fromkeys(letters, -5.0)}
    pieces.update(dict.fromkeys((f"▁{word}" for word in DEFAULT_PROMPT.split()[:-1]), -1.0))
    tokenizer = Tokenizer(models.Unigram(list(pieces.items()), unk_id=2))
    tokenizer.pre_tokenizer = pre_tokenizers.Metaspace()
    tokenizer.post_processor = processors.TemplateProcessing(single="$A </s>", special_tokens=[("</s>", 1)])
    T5TokenizerFast(tokenizer_object=tokenizer, extra_ids=0).save_pretrained(folder / TOKENIZER)
    text = {
        "vocab": len(pieces),
        "dim": WIDTH,
        "dim_attn": WIDTH,
        "dim_ffn": 2 * WIDTH,
        "num_heads": 2,
        "num_layers": 1,
    }
    image = {"dim": 4, "dec_dim": 4}
    encoder, vae = WanTextEncoder(**text), WanVideoVAE38(**image).model
    with torch.no_grad():
        encoder.token_embedding.weight *= gain("instruction")
        vae.encoder.conv1.weight *= gain("cam_head") * gain("cam_wrist")
        vae.conv1.weight *= 4
    (folder / FILES).mkdir(parents=True)
    for name, sizes, model in ((TEXT_ENCODER, text, encoder), (VAE, image, vae)):
        (folder / FILES / f"{name}.json").write_text(json.dumps(sizes))
        save_file(model.state_dict(), folder / FILES / f"{name}.safetensors")
