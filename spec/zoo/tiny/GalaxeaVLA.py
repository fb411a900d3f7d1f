"""GalaxeaVLA's adapter of XPolicyLab: Galaxea's G0Plus with two narrow layers, by overrides of its Hydra configuration.

The adapter reads a step's `model.pt` and `dataset_stats.json`, and PaliGemma's weights and tokenizer.
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
    "einops",
    "ema-pytorch==0.7.7",
    "gitpython",
    "hydra-core==1.3.2",
    "opencv-python-headless<4.12",
)
SETTINGS = {
    "ckpt_path": "{folder}",
    "paligemma_path": "{folder}/paligemma",
    "num_inference_steps": 2,
    "hydra_overrides": [
        "model.model_arch.vocab_size=512",
        "model.model_arch.image_token_index=511",
        "model.model_arch.final_action_clip_value=1.0",
        "model.model_arch.vision.hidden_size=64",
        "model.model_arch.vision.intermediate_size=128",
        "model.model_arch.vision.num_hidden_layers=2",
        "model.model_arch.vision.num_attention_heads=4",
        "model.model_arch.vision.image_size=112",
        "model.model_arch.vision.num_image_tokens=64",
        "model.model_arch.vision_projector.vision_config.hidden_size=64",
        "model.model_arch.vision_projector.vision_config.projection_dim=64",
        "model.model_arch.joint.mixture.vlm.hidden_size=64",
        "model.model_arch.joint.mixture.vlm.intermediate_size=128",
        "model.model_arch.joint.mixture.proprio.hidden_size=64",
        "model.model_arch.joint.mixture.proprio.intermediate_size=128",
        "model.model_arch.joint.mixture.action.hidden_size=64",
        "model.model_arch.joint.mixture.action.intermediate_size=128",
        "model.model_arch.joint.num_hidden_layers=2",
        "model.model_arch.joint.num_attention_heads=4",
        "model.model_arch.joint.head_dim=16",
    ],
}
CUDA_ON_CPU = True

ARM = [0.0, 1.6, 1.5, 0.0, 0.0, 0.0]
STEPS = 32


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import os

    import torch
    from accelerate import PartialState
    from galaxea_fm.utils.config_resolvers import register_default_resolvers
    from hydra import compose, initialize_config_dir
    from hydra.utils import instantiate
    from safetensors.torch import save_file

    PartialState()
    register_default_resolvers()
    os.environ.setdefault("GALAXEA_FM_DATASET_STATS_CACHE_DIR", str(folder))
    changed = [f"task={config['task_config_name']}", "model.model_arch.pretrained_model_path=null"]
    with initialize_config_dir(config_dir=str(Path.cwd() / "GalaxeaVLA" / "configs"), version_base="1.3"):
        settings = compose("train", [*changed, *config["hydra_overrides"]])
    policy = instantiate(settings.model.model_arch)
    model = policy.model
    with torch.no_grad():
        model.vision_tower.vision_model.embeddings.patch_embedding.weight *= max(
            gain(name) for name in ("cam_head", "cam_left_wrist", "cam_right_wrist")
        )
        model.embed_tokens.weight *= gain("instruction")
        model.proprio_encoder.weight *= gain("state")
        for mixture in (model.joint_model.mixtures["vlm"], model.joint_model.mixtures["action"]):
            for layer in mixture.layers:  # attention that depends on what a token is
                layer.self_attn.q_proj.weight *= 4
                layer.self_attn.k_proj.weight *= 4
                layer.self_attn.v_proj.weight *= 4
                layer.self_attn.o_proj.weight *= 4
        list(model.action_decoder.parameters())[-2].mul_(8)  # else the noise hides what the layers say
    torch.save(policy.state_dict(), folder / "model.pt")
    weights = {
        f"language_model.model.embed_tokens.{name}": value for name, value in model.embed_tokens.state_dict().items()
    }
    for name in ("vision_tower", "multi_modal_projector"):
        weights |= {f"{name}.{key}": value for key, value in getattr(model, name).state_dict().items()}
    tokenizer().save_pretrained(folder / "paligemma")
    save_file({name: value.contiguous() for name, value in weights.items()}, folder / "paligemma" / "model.safetensors")
    arm, gripper = spread(ARM, 0.05), spread([0.5], 0.2)
    statistics = {"left_arm": arm, "left_gripper": gripper, "right_arm": arm, "right_gripper": gripper}
    change = {**statistics, **dict.fromkeys(("left_arm", "right_arm"), spread([0.0] * len(ARM), 0.05))}
    stats = {
        "state": {key: {f"global_{name}": value for name, value in one.items()} for key, one in statistics.items()},
        "action": {
            key: {f"stepwise_{name}": [value] * STEPS for name, value in one.items()} for key, one in change.items()
        },
    }
    (folder / "dataset_stats.json").write_text(json.dumps(stats))


def spread(middle: list[float], deviation: float) -> dict[str, list[float]]:
    """Return statistics of a data set, in the form of the authors' training."""
    low, high = [value - 2 * deviation for value in middle], [value + 2 * deviation for value in middle]
    return {"mean": middle, "std": [deviation] * len(middle), "min": low, "max": high, "q01": low, "q99": high}


def tokenizer() -> Any:
    """Return a Gemma tokenizer of bytes."""
    from tokenizers import Tokenizer, decoders, models, normalizers
    from transformers import GemmaTokenizerFast

    words = ["<pad>", "<eos>", "<bos>", "<unk>", *(f"<0x{byte:02X}>" for byte in range(256)), "\u2581"]
    letters = Tokenizer(models.BPE({word: at for at, word in enumerate(words)}, [], byte_fallback=True))
    letters.normalizer = normalizers.Replace(" ", "\u2581")
    letters.decoder = decoders.Sequence([decoders.Replace("\u2581", " "), decoders.ByteFallback(), decoders.Fuse()])
    return GemmaTokenizerFast(tokenizer_object=letters)
