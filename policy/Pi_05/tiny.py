"""Tiny random checkpoint: openpi's pi_0.5 with its smallest vision tower, one narrow layer, a tokenizer of letters."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

TEXT = 4.0  # scales the values that attention reads of the prompt: a few letters among hundreds of patches
CONFIG = {
    "action_dim": 32,
    "action_horizon": 10,
    "paligemma_variant": "tiny",
    "action_expert_variant": "tiny",
    "pytorch_compile_mode": None,
}


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the weights that read an input."""
    from openpi.shared import normalize
    from openpi.training import config as training

    train = training.get_config(config["train_config"])
    model = dataclasses.replace(train.model, **CONFIG)
    (folder / "config.json").write_text(json.dumps(CONFIG, indent=2))
    (save_pytorch if config.get("variant") == "pytorch" else save_jax)(folder, model, gain)
    statistics = {
        name: normalize.NormStats(
            mean=np.zeros(width), std=np.ones(width), q01=np.full(width, -0.3), q99=np.full(width, 0.3)
        )
        for name, width in (("state", 8), ("actions", 7))
    }
    normalize.save(folder / "assets" / train.data.repo_id, statistics)
    path = folder / "openpi" / "big_vision" / "paligemma_tokenizer.model"
    path.parent.mkdir(parents=True)
    path.write_bytes(tokenizer())


def save_jax(folder: Path, model: Any, gain: Callable[[str], float]) -> None:
    """Save the parameters as openpi's training does, with orbax."""
    import flax.traverse_util
    import jax
    import orbax.checkpoint as ocp
    from flax import nnx

    draw = np.random.default_rng(0)
    weights = flax.traverse_util.flatten_dict(nnx.state(model.create(jax.random.key(0))).to_pure_dict(), sep="/")
    for name, values in weights.items():
        weights[name] = np.array(values, np.float32)
        if not np.any(values) and name.endswith("kernel"):  # fresh layers that answer zero
            weights[name][:] = draw.normal(size=values.shape, scale=values.shape[-2] ** -0.5)
    weights["PaliGemma/img/head/kernel"] *= gain("cam_head") * gain("cam_wrist")
    weights["PaliGemma/llm/layers/attn/kv_einsum/w"][:, 1] *= TEXT * gain("instruction")  # (layer, key or value, ...)
    with ocp.PyTreeCheckpointer() as saver:
        saver.save(folder.resolve() / "params", {"params": flax.traverse_util.unflatten_dict(weights, sep="/")})


def save_pytorch(folder: Path, model: Any, gain: Callable[[str], float]) -> None:
    """Save the parameters as openpi's converter does, with safetensors."""
    import safetensors.torch
    import torch
    from openpi.models_pytorch.pi0_pytorch import PI0Pytorch

    policy = PI0Pytorch(model)
    network = policy.paligemma_with_expert.paligemma
    with torch.no_grad():
        network.model.multi_modal_projector.linear.weight *= gain("cam_head") * gain("cam_wrist")
        network.model.language_model.layers[0].self_attn.v_proj.weight *= TEXT * gain("instruction")
    safetensors.torch.save_model(policy, str(folder / "model.safetensors"))


def tokenizer() -> bytes:
    """Return a sentencepiece model with PaliGemma's special tokens, of letters and bytes."""
    import sentencepiece

    model = io.BytesIO()
    sentencepiece.SentencePieceTrainer.train(
        sentence_iterator=iter(["the quick brown fox jumps over the lazy dog", "0123456789.,:;-|"]),
        model_writer=model,
        model_type="char",
        vocab_size=512,
        hard_vocab_limit=False,
        byte_fallback=True,
        normalization_rule_name="identity",
        add_dummy_prefix=False,
        remove_extra_whitespaces=False,
        pad_id=0,
        eos_id=1,
        bos_id=2,
        unk_id=3,
        minloglevel=2,
    )
    return model.getvalue()
