"""What recipes of tiny random checkpoints share: weights that pass their inputs on, tokenizers of bytes, statistics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

ARX_X5 = (0.0, 1.5, 1.5, 0.0, 0.0, 0.0, 0.5)
"""A pose amid the limits of the joints of an ARX X5, rad, and of its gripper."""
QWEN = (
    "<|endoftext|>",
    "<|im_start|>",
    "<|im_end|>",
    "<|vision_start|>",
    "<|vision_end|>",
    "<|vision_pad|>",
    "<|image_pad|>",
    "<|video_pad|>",
)
"""Special tokens of Qwen's tokenizer, after the 256 bytes."""
CHAT = (
    "{% for message in messages %}<|im_start|>{{ message.role }}\n"
    "{% if message.content is string %}{{ message.content }}{% else %}{% for part in message.content %}"
    "{% if part.type == 'image' %}<|vision_start|><|image_pad|><|vision_end|>"
    "{% elif part.type == 'video' %}<|vision_start|><|video_pad|><|vision_end|>"
    "{% else %}{{ part.text }}{% endif %}{% endfor %}{% endif %}<|im_end|>\n"
    "{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)
"""Qwen's chat template, without tools and numbers of images."""
_LARGE = 2**13
"""Numbers from which a tensor is worth a view."""


def enliven(network: Any) -> None:
    """Draw the weights of linear and convolutional layers anew, for unit variance behind them.

    The usual deviation of 0.02 suits wide layers; narrow ones would pass nothing on.
    """
    from torch import nn

    for layer in network.modules():
        if isinstance(layer, (nn.Linear, nn.Conv1d, nn.Conv2d, nn.Conv3d)):
            nn.init.normal_(layer.weight, std=layer.weight[0].numel() ** -0.5)


def moments(centre: Sequence[float], spread: float) -> dict[str, list[float]]:
    """Return the statistics of numbers around a centre for every rule of normalization, as lists."""
    low, high = [value - 2 * spread for value in centre], [value + 2 * spread for value in centre]
    return {
        "mean": list(centre),
        "std": [spread] * len(centre),
        **dict.fromkeys(("min", "q01", "q10"), low),
        "q50": list(centre),
        **dict.fromkeys(("max", "q99", "q90"), high),
    }


def byte_vocabulary(first: Sequence[str] = (), last: Sequence[str] = ()) -> dict[str, int]:
    """Return the vocabulary of a byte-level BPE without merges, between special tokens."""
    from tokenizers.pre_tokenizers import ByteLevel

    return {token: number for number, token in enumerate([*first, *sorted(ByteLevel.alphabet()), *last])}


def byte_tokenizer(last: Sequence[str] = ()) -> Any:
    """Return a byte-level BPE without merges, of the library tokenizers, with special tokens at the end."""
    from tokenizers import AddedToken, Tokenizer, decoders, models, pre_tokenizers

    tokenizer = Tokenizer(models.BPE(vocab=byte_vocabulary(last=last), merges=[]))
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    tokenizer.add_special_tokens([AddedToken(token, special=True, normalized=False) for token in last])
    return tokenizer


def qwen_tokenizer(more: Sequence[str] = ()) -> Any:
    """Return Qwen's tokenizer with single bytes for tokens, by the class that transformers 4 and 5 have."""
    from transformers import Qwen2TokenizerFast

    return Qwen2TokenizerFast(
        tokenizer_object=byte_tokenizer([*QWEN, *more]),
        eos_token="<|im_end|>",  # noqa: S106
        pad_token="<|endoftext|>",  # noqa: S106
        additional_special_tokens=[*QWEN[1:], *more],
        chat_template=CHAT,
    )


def save_qwen3_vl(folder: Path, width: int) -> None:
    """Save a Qwen3-VL of three narrow layers with a tokenizer of bytes, and its processor.

    Args:
        folder: as which repository of the hub the authors' code reads it.
        width: of its hidden states, a multiple of 16.
    """
    from transformers import (
        Qwen2VLImageProcessorFast,
        Qwen3VLConfig,
        Qwen3VLForConditionalGeneration,
        Qwen3VLProcessor,
        Qwen3VLVideoProcessor,
    )

    words = qwen_tokenizer()
    sizes = {"size": {"shortest_edge": 65536, "longest_edge": 16777216}, "patch_size": 16, "temporal_patch_size": 2}
    halves = {"image_mean": [0.5] * 3, "image_std": [0.5] * 3}
    images, videos = Qwen2VLImageProcessorFast(**sizes, **halves), Qwen3VLVideoProcessor(**sizes, **halves)
    Qwen3VLProcessor(images, words, videos, CHAT).save_pretrained(folder)
    first, last, _, image, video = words.convert_tokens_to_ids(QWEN[3:])
    common = {"hidden_size": width, "intermediate_size": 2 * width, "initializer_range": width**-0.5}
    text = {
        **common,
        "vocab_size": len(words),
        "num_hidden_layers": 3,
        "num_attention_heads": 4,
        "num_key_value_heads": 2,
        "head_dim": 16,
        "rope_scaling": {"rope_type": "default", "mrope_interleaved": True, "mrope_section": [4, 2, 2]},
    }
    vision = {
        **common,
        "depth": 2,
        "num_heads": 4,
        "out_hidden_size": width,
        "num_position_embeddings": 256,
        "deepstack_visual_indexes": [0],
    }
    settings = Qwen3VLConfig(text, vision, image, video, first, last, tie_word_embeddings=True)
    Qwen3VLForConditionalGeneration(settings).save_pretrained(folder)


def few(weight: Any) -> Any:
    """Return a large tensor of the same shape and deviation whose diagonals repeat, so that `torch.save` keeps little.

    For layers whose widths the authors' code fixes: a random matrix with equal numbers along its diagonals has full
    rank, and is a view of rows + columns numbers. safetensors has no such views.
    """
    import torch

    if weight.numel() < _LARGE or not weight.is_floating_point():
        return weight
    strides = [1, 2, 5, 11, 23][: weight.ndim][::-1]
    size = 1 + sum(step * (length - 1) for step, length in zip(strides, weight.shape))
    return (torch.randn(size) * weight.float().std() + weight.float().mean()).as_strided(weight.shape, strides)
