"""GigaWorldPolicy's adapter of XPolicyLab: a narrow Wan video model, its encoder and T5, with one layer of each expert.

The adapter reads the base model's folders in the form of diffusers, `model_ema.pt` and norm_stats_delta.json. The width
of the action expert is fixed in its code: its large matrices are of few numbers.
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
    "diffusers==0.37.1",
    "transformers==4.57.1",
    "msgpack",
    "ftfy",
    "einops",
    "wandb",
    "accelerate",
    "h5py",
)
SETTINGS = {
    "checkpoint_path": "{folder}",
    "base_model_path": "{folder}/wan",
    "stats_path": "{folder}/norm_stats_delta.json",
    "num_steps": 2,
    "dst_size": [64, 64],
}
CUDA_ON_CPU = True
LATENT, TEXT = 4, 32


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import_module("XPolicyLab.policy.GigaWorldPolicy.model")  # which makes the vendored code importable
    import torch
    from diffusers.models import AutoencoderKLWan
    from transformers import PreTrainedTokenizerFast, UMT5Config, UMT5EncoderModel
    from world_action_model.models.transformer_wa_mot import MoTWanVideoExpert, MoTWorldActionTransformer

    from xpl.training.tiny_parts import byte_tokenizer, enliven, few, moments

    wan = folder / "wan"
    encoder = AutoencoderKLWan(
        base_dim=8,
        z_dim=LATENT,
        dim_mult=[1, 1, 1, 1],
        num_res_blocks=1,
        latents_mean=[0.0] * LATENT,
        latents_std=[1.0] * LATENT,
    )
    enliven(encoder)
    with torch.no_grad():
        encoder.encoder.conv_in.weight *= gain("cam_head") * gain("cam_left_wrist") * gain("cam_right_wrist")
    encoder.save_pretrained(wan / "vae")
    words = PreTrainedTokenizerFast(
        tokenizer_object=byte_tokenizer(("<pad>", "</s>")),
        pad_token="<pad>",  # noqa: S106
        eos_token="</s>",  # noqa: S106
        model_input_names=["input_ids", "attention_mask"],
    )
    words.save_pretrained(wan / "tokenizer")
    text = UMT5EncoderModel(UMT5Config(len(words), TEXT, TEXT // 4, 2 * TEXT, num_layers=2, num_heads=4))
    with torch.no_grad():
        text.shared.weight.normal_().mul_(gain("instruction"))
    text.save_pretrained(wan / "text_encoder")
    video = MoTWanVideoExpert(
        num_attention_heads=2,
        attention_head_dim=24,
        in_channels=LATENT,
        out_channels=LATENT,
        text_dim=TEXT,
        freq_dim=32,
        ffn_dim=96,
        num_layers=1,
    )
    enliven(video)
    video.save_pretrained(wan / "transformer")
    sizes = {"action_dim": config["model_action_dim"], "state_dim": config["model_state_dim"]}
    model = MoTWorldActionTransformer.from_pretrained_video(str(wan / "transformer"), torch.float32, **sizes)
    enliven(model)
    with torch.no_grad():
        model.action_expert.state_encoder[0].weight *= gain("state")
    weights = {f"transformer.{name}": few(weight) for name, weight in model.state_dict().items()}
    torch.save(weights, folder / "model_ema.pt")
    spread = {
        "observation.state": moments([0.0] * sizes["state_dim"], 0.5),
        "action": moments(([0.0] * 6 + [0.5]) * 2, 0.05),
    }
    (folder / "norm_stats_delta.json").write_text(json.dumps({"norm_stats": spread}))
