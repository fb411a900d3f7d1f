"""Tiny random checkpoint: H-RDT, DINOv2, SigLIP and T5 of their own classes, with shrunken configurations."""

from __future__ import annotations

import json
import string
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

WIDTH, ACTIONS, STEPS = 64, 14, 16
MIDDLE = (-0.25, 1.7, 1.5, 0.0, 0.0, 0.0)
"""Of the joints' limits, rad."""
ENCODERS = {  # folder of the weights: their file, and what is before each name in it
    "vit_large_patch14_reg4_dinov2.lvd142m": ("pytorch_model.bin", ""),
    "vit_so400m_patch14_siglip_384": ("open_clip_pytorch_model.bin", "visual.trunk."),
}


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    import deploy_policy
    import timm
    import torch
    import yaml
    from models.hrdt_runner import HRDTRunner
    from transformers import T5Config, T5EncoderModel

    shape = {"embed_dim": WIDTH // 2, "depth": 2, "num_heads": 2}
    for name, (file, prefix) in ENCODERS.items():
        weights = folder / "bak/dino-siglip" / name
        weights.mkdir(parents=True)
        encoder = timm.create_model(name, num_classes=0, **shape)
        torch.save({prefix + key: value for key, value in encoder.state_dict().items()}, weights / file)
        (weights / "config.json").write_text(json.dumps({"architecture": name, "model_args": shape}))
    text = folder / "hub/google--t5-v1_1-xxl"
    words = tokenizer()
    words.save_pretrained(text)
    T5EncoderModel(
        T5Config(
            vocab_size=len(words), d_model=WIDTH, d_kv=16, d_ff=128, num_layers=1, num_heads=4,
            feed_forward_proj="gated-gelu", tie_word_embeddings=False,
        )
    ).save_pretrained(text)  # fmt: skip

    settings = yaml.safe_load((Path(deploy_policy.__file__).parent / "utils/hrdt.yaml").read_text(encoding="utf-8"))
    model = settings["model"]
    model["hrdt"].update(hidden_size=WIDTH, depth=1, num_heads=4, num_kv_heads=2, multiple_of=32)
    model["vision"]["feature_dim"] = model["text"]["feature_dim"] = WIDTH
    model["noise_scheduler"]["num_inference_timesteps"] = 1
    model["act_adaptor"] = "linear"
    (folder / "hrdt.yaml").write_text(yaml.safe_dump(settings))
    tokens = (384 // 14) ** 2
    policy = HRDTRunner(
        state_dim=ACTIONS,
        action_dim=ACTIONS,
        pred_horizon=STEPS,
        config=model,
        act_pos_emb_config=[("state", 1), ("action", STEPS)],
        img_pos_emb_config=[("image", (1, 3, -tokens))],
        lang_pos_emb_config=[("lang", -1024)],
        max_img_len=3 * tokens,
        max_lang_len=1024,
        dtype=torch.float32,
    )
    with torch.no_grad():
        denoise(policy)
        block = policy.model.blocks[0]
        block.attn.wo.weight *= 2 * gain("state")
        block.img_cross_attn.wo.weight *= max(gain(name) for name in ("cam_head", "cam_left_wrist", "cam_right_wrist"))
        block.lang_cross_attn.wo.weight *= 0.5 * gain("instruction")
    policy.bfloat16().save_pretrained(folder)


def denoise(policy: Any) -> None:
    """Let the network subtract the noise, which random weights leave in the action.

    The first numbers of a token are the noisy action, to which attention and MLP add; its others are constant, so that
    layer norm hardly changes them. The decoder subtracts the first numbers: what attention and MLP added is the action.
    """
    import torch

    share, spread = 0.25, 2.0
    carry = torch.eye(ACTIONS, WIDTH)
    policy.action_encoder.action_adaptor.weight.copy_(share * carry.T)
    place = torch.nn.functional.layer_norm(torch.randn(1 + STEPS, WIDTH - ACTIONS), [WIDTH - ACTIONS])
    policy.model.x_pos_emb.zero_()[0, :, ACTIONS:] = spread * place
    block, decoder = policy.model.blocks[0], policy.model.action_decoder.ffn
    gates = block.adaLN_modulation[-1].bias.view(9, WIDTH)
    gates[[2, 5, 8]] = 1.0  # of attention, images and MLP; its authors begin with zeros
    for layer in (block.attn.wo, block.img_cross_attn.wo, block.lang_cross_attn.wo, block.ffn.w2):
        layer.weight *= 0.08
        layer.weight[[6, 13]] *= 0.2  # the grippers', which may not leave 0..1
    decoder.fc1.weight.zero_()[: 2 * ACTIONS] = torch.cat([carry, -carry])  # silu(x) - silu(-x) is x
    scale = spread * (1 - ACTIONS / WIDTH) ** 0.5 / share
    decoder.fc2.weight.zero_()[:, : 2 * ACTIONS] = scale * torch.cat([-torch.eye(ACTIONS), torch.eye(ACTIONS)], 1)
    decoder.fc2.bias.copy_(torch.tensor([*MIDDLE, 0.7, *MIDDLE, 0.7]))


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
