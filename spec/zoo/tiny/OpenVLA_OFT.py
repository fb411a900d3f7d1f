"""OpenVLA-OFT's adapter of XPolicyLab: OpenVLA's own classes with FiLM, two narrow vision towers and a narrow Llama.

The adapter reads the merged model, `vision_backbone`, `action_head` and `proprio_projector` of a step, and statistics.
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
    "timm==0.9.16",
    "tensorflow==2.15.0",
    "peft==0.11.1",
    "draccus==0.8.0",
    "json-numpy==2.1.1",
    "jsonlines",
    "wandb==0.17.9",
    "tensorflow-datasets==4.9.3",
    "tensorflow-graphics==2021.12.3",
    "opencv-python-headless<4.12",
    "dlimp @ https://github.com/moojink/dlimp_openvla/archive/refs/heads/main.zip",
    "transformers @ https://github.com/moojink/transformers-openvla-oft/archive/refs/heads/main.zip",
)
SETTINGS = {"checkpoint_path": "{folder}", "lora_rank": 2}

WIDTH, HEADS, SIZE, VOCABULARY = 64, 4, 112, 32000
TOWERS = {"tiny/dinov2": "vit_large_patch14_reg4_dinov2", "tiny/siglip": "vit_so400m_patch14_siglip_224"}
"""The vision towers of the published checkpoints, by the names that the tiny ones have in timm's form of a hub."""
MEAN_STD = {"means": [(0.485, 0.456, 0.406), (0.5, 0.5, 0.5)], "stds": [(0.229, 0.224, 0.225), (0.5, 0.5, 0.5)]}
LOW = [-0.5, 1.2, 1.0, -0.4, -0.4, -0.4, 0.1] * 2
HIGH = [0.5, 2.0, 2.0, 0.4, 0.4, 0.4, 0.9] * 2
"""Of each joint and gripper of `arx_x5`."""


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    sys.argv.append("--aloha")  # as the adapter does: the authors' constants depend on it
    import torch
    from peft import LoraConfig, get_peft_model
    from prismatic.extern.hf.configuration_prismatic import OpenVLAConfig
    from prismatic.extern.hf.modeling_prismatic import OpenVLAForActionPrediction
    from prismatic.extern.hf.processing_prismatic import PrismaticImageProcessor, PrismaticProcessor
    from prismatic.models.action_heads import L1RegressionActionHead
    from prismatic.models.film_vit_wrapper import FiLMedPrismaticVisionBackbone
    from prismatic.models.projectors import ProprioProjector

    from xpl import hub

    for name, architecture in TOWERS.items():
        tower = folder / hub.FOLDER / name.replace("/", "--") / "config.json"
        tower.parent.mkdir(parents=True)
        sizes = {"depth": 2, "embed_dim": WIDTH, "num_heads": HEADS, "mlp_ratio": 2}
        tower.write_text(json.dumps({"architecture": architecture, "pretrained_cfg": {}, "model_args": sizes}))
    hub.pack(folder / hub.FOLDER)  # the model's constructor reads them by their names
    numbers = {"min": LOW, "max": HIGH, "q01": LOW, "q99": HIGH, "mask": [True] * len(LOW)}
    statistics = {"aloha_tiny": {"action": numbers, "proprio": numbers}}
    settings = OpenVLAConfig(
        vision_backbone_id="dinosiglip-vit-so-224px",
        llm_backbone_id="llama2-7b-pure",
        image_resize_strategy="resize-naive",
        image_sizes=[SIZE] * 2,
        timm_model_ids=[f"hf-hub:{name}" for name in TOWERS],
        torch_dtype="bfloat16",
        norm_stats=statistics,
        text_config={
            "vocab_size": VOCABULARY + 64,
            "hidden_size": WIDTH,
            "intermediate_size": 2 * WIDTH,
            "num_hidden_layers": 2,
            "num_attention_heads": HEADS,
            "rms_norm_eps": 0.1,  # otherwise each token would count the same, whatever its gain
            "pad_token_id": VOCABULARY,
            "torch_dtype": "bfloat16",
        },
    )
    OpenVLAConfig.register_for_auto_class()
    PrismaticImageProcessor.register_for_auto_class("AutoImageProcessor")
    PrismaticProcessor.register_for_auto_class("AutoProcessor")
    OpenVLAForActionPrediction.register_for_auto_class("AutoModelForVision2Seq")
    model = OpenVLAForActionPrediction(settings)
    head = L1RegressionActionHead(WIDTH, WIDTH, len(LOW))
    proprio = ProprioProjector(WIDTH, len(LOW))
    with torch.no_grad():
        for tower in (model.vision_backbone.featurizer, model.vision_backbone.fused_featurizer):
            tower.patch_embed.proj.weight *= max(gain(f"cam_{name}") for name in ("head", "left_wrist", "right_wrist"))
        model.language_model.model.embed_tokens.weight *= gain("instruction")
        proprio.fc1.weight *= 16 * gain("state")
        head.model.fc2.weight *= 0.4  # the grippers may not leave 0..1
        for layer in model.language_model.model.layers:  # attention that depends on what a token is, and where
            layer.self_attn.q_proj.weight *= 128
            layer.self_attn.k_proj.weight *= 128
    model.to(torch.bfloat16).save_pretrained(folder)
    trained = get_peft_model(
        model,
        LoraConfig(r=config["lora_rank"], lora_alpha=2, target_modules="all-linear", init_lora_weights="gaussian"),
    )
    vision = FiLMedPrismaticVisionBackbone(vision_backbone=trained.vision_backbone, llm_dim=WIDTH)
    for name, module in {"vision_backbone": vision, "action_head": head, "proprio_projector": proprio}.items():
        torch.save(module.to(torch.bfloat16).state_dict(), folder / f"{name}--1_checkpoint.pt")
    images = PrismaticImageProcessor(
        use_fused_vision_backbone=True,
        image_resize_strategy="resize-naive",
        input_sizes=[(3, SIZE, SIZE)] * 2,
        interpolations=["bicubic"] * 2,
        **MEAN_STD,
    )
    PrismaticProcessor(images, tokenizer()).save_pretrained(folder)
    (folder / "dataset_statistics.json").write_text(json.dumps(statistics))


def tokenizer() -> Any:
    """Return a Llama tokenizer of bytes."""
    from tokenizers import AddedToken, Tokenizer, decoders, models, normalizers
    from transformers import LlamaTokenizerFast

    words = ["<unk>", "<s>", "</s>", *(f"<0x{byte:02X}>" for byte in range(256)), "\u2581"]
    words += [f"<{at}>" for at in range(len(words), VOCABULARY)]
    letters = Tokenizer(models.BPE({word: at for at, word in enumerate(words)}, [], byte_fallback=True))
    letters.normalizer = normalizers.Sequence([normalizers.Prepend("\u2581"), normalizers.Replace(" ", "\u2581")])
    letters.decoder = decoders.Sequence([decoders.Replace("\u2581", " "), decoders.ByteFallback(), decoders.Fuse()])
    tokenizer = LlamaTokenizerFast(tokenizer_object=letters, model_max_length=2048, padding_side="right")
    tokenizer.add_special_tokens({"pad_token": AddedToken("<PAD>")})
    return tokenizer
