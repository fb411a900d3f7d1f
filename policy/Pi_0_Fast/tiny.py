"""Tiny checkpoint: openpi's pi_0-FAST with its smallest vision tower, one narrow layer, and weights with the grammar.

A FAST model answers tokens, and only `Action: `, ten rows of coefficients and `|` make a chunk: random tokens are
decoded to zeros. So each token has a class, one channel of its embedding; the MLP, at a token of a class, asks for the
class that follows. Which token of the class it becomes is up to random weights, and to what attention read.
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

CONFIG: dict[str, Any] = {
    "action_dim": 8,
    "action_horizon": 10,
    "max_token_len": 250,
    "paligemma_variant": "tiny",
    "dtype": "float32",  # bfloat16 rounds the logits of a class to equal ones
}
ROWS, CHOICES = CONFIG["action_horizon"], 32  # one FAST token is one row of a chunk's coefficients
SKIPPED = 128  # last tokens of the vocabulary, which no action has
LINE_END, ACTION, END = 4, 5, 6  # tokens: "\n", "Action: ", "|"
EOS = 1
CLASSES = 16  # "\n", "Action: ", ten rows, "|", the end, text, digits
TEXT, DIGITS, IMAGES = 14, 15, 16  # channels
WIDTH, HIDDEN, HEADS, SIZE = 64, 128, 2, 16  # of the tiny variant
SLOW = 7  # pair of a head's channels that rotary embeddings turn least
FIRST_ROW = ord("一")
SYMBOLS = "".join(chr(FIRST_ROW + index) for index in range(ROWS * CHOICES))


def write(folder: Path, gain: Callable[[str], float], config: Mapping[str, Any]) -> None:
    """Write the checkpoint; `gain` scales the attention that an input gets."""
    import flax.traverse_util
    import jax
    import orbax.checkpoint as ocp
    from flax import nnx
    from openpi.shared import normalize
    from openpi.training import config as training

    train = training.get_config(config["train_config"])
    model = dataclasses.replace(train.model, **CONFIG)
    (folder / "config.json").write_text(json.dumps(CONFIG, indent=2))
    vision = model.create(jax.random.key(0)).PaliGemma.img
    weights = flax.traverse_util.flatten_dict(nnx.state(vision).to_pure_dict(), sep="/")
    weights = {f"PaliGemma/img/{name}": np.array(values, np.float32) for name, values in weights.items()}
    words, proto = tokenizer()
    weights |= {f"PaliGemma/llm/{name}": values for name, values in language(words, gain).items()}
    head = np.random.default_rng(1).normal(size=weights["PaliGemma/img/head/kernel"].shape)
    head[:, : IMAGES + 1] = 0
    weights["PaliGemma/img/head/kernel"] = 2 * head * gain("cam_head") * gain("cam_wrist")
    weights["PaliGemma/img/head/bias"][IMAGES] = 8
    tree = flax.traverse_util.unflatten_dict({k: np.asarray(v, np.float32) for k, v in weights.items()}, sep="/")
    with ocp.PyTreeCheckpointer() as saver:
        saver.save(folder.resolve() / "params", {"params": tree})
    one = normalize.NormStats(mean=np.zeros(8), std=np.ones(8), q01=np.full(8, -2.0), q99=np.full(8, 2.0))
    normalize.save(folder / "assets" / train.data.assets.asset_id, {"state": one, "actions": one})
    path = folder / "openpi" / "big_vision" / "paligemma_tokenizer.model"
    path.parent.mkdir(parents=True)
    path.write_bytes(proto)
    action_tokenizer(folder / "hub" / "physical-intelligence--fast")


def language(words: Any, gain: Callable[[str], float]) -> dict[str, np.ndarray]:
    """Return the weights of the language model."""
    draw = np.random.default_rng(0)

    def random(*shape: int) -> np.ndarray:
        return draw.normal(size=shape)

    content = slice(IMAGES + 1, WIDTH)
    embedding = np.zeros((1024, WIDTH))
    embedding[: words.vocab_size(), content] = random(words.vocab_size(), 47) * 0.25
    last = words.vocab_size() - 1 - SKIPPED
    for token in range(words.vocab_size()):
        embedding[token, DIGITS if words.id_to_piece(token).strip("▁").isdigit() else TEXT] = 1
    grammar = [
        [LINE_END],
        [ACTION],
        *([last - row * CHOICES - i for i in range(CHOICES)] for row in range(ROWS)),
        [END],
        [EOS],
    ]
    for kind, tokens in enumerate(grammar):
        embedding[tokens, TEXT] = 0
        embedding[tokens, kind] = 1

    query, key_value = np.zeros((1, HEADS, WIDTH, SIZE)), np.zeros((1, 2, 1, WIDTH, SIZE))
    query[..., content, :], key_value[..., content, :] = random(1, HEADS, 47, SIZE) / 7, random(1, 2, 1, 47, SIZE) / 7
    query[..., SLOW] = key_value[:, 0, ..., SLOW] = 0
    query[:, :, :TEXT, SLOW] = 1
    for channel, weight in ((TEXT, 16 * gain("instruction")), (DIGITS, 64 * gain("state"))):
        key_value[:, 0, :, channel, SLOW] = np.log(weight) / 4
    output = np.zeros((1, HEADS, SIZE, WIDTH))
    output[..., content] = random(1, HEADS, SIZE, 47) * 4

    gates, linear = np.zeros((1, 2, WIDTH, HIDDEN)), np.zeros((1, HIDDEN, WIDTH))
    for kind in range(len(grammar) - 1):  # at a token of this class, ask for the one that follows
        gates[:, :, kind, kind] = 100
        linear[:, kind, kind], linear[:, kind, kind + 1] = -1, 1
    return {
        "embedder/input_embedding": embedding,
        "final_norm/scale": np.zeros(WIDTH),
        "layers/attn/q_einsum/w": query,
        "layers/attn/kv_einsum/w": key_value,
        "layers/attn/attn_vec_einsum/w": output,
        "layers/mlp/gating_einsum": gates,
        "layers/mlp/linear": linear,
        "layers/pre_attention_norm/scale": np.zeros((1, WIDTH)),
        "layers/pre_ffw_norm/scale": np.zeros((1, WIDTH)),
    }


def tokenizer() -> tuple[Any, bytes]:
    """Return a sentencepiece model: PaliGemma's special tokens, bytes, letters, a symbol for each action token."""
    import sentencepiece

    skipped = "".join(chr(ord("帀") + index) for index in range(SKIPPED))  # rare symbols are last
    text = "the quick brown fox jumps over the lazy dog 0123456789.,:;-?' " * 9 + SYMBOLS * 3 + skipped
    model = io.BytesIO()
    sentencepiece.SentencePieceTrainer.train(
        sentence_iterator=iter([text]),
        model_writer=model,
        model_type="char",
        vocab_size=1024,
        hard_vocab_limit=False,
        byte_fallback=True,
        character_coverage=1.0,
        normalization_rule_name="identity",
        add_dummy_prefix=False,
        remove_extra_whitespaces=False,
        pad_id=0,
        eos_id=EOS,
        bos_id=2,
        unk_id=3,
        user_defined_symbols=["\n", "Action:▁", "|"],
        minloglevel=2,
    )
    return sentencepiece.SentencePieceProcessor(model_proto=model.getvalue()), model.getvalue()


def action_tokenizer(folder: Path) -> None:
    """Write what stands in for the hub's FAST tokenizer: tokens of a row of coefficients, and the inverse transform."""
    from tokenizers import Tokenizer, decoders, models
    from transformers import PreTrainedTokenizerFast

    draw, least, scale = np.random.default_rng(2), -354, 10
    spread = 8 / (1 + np.arange(ROWS))  # slow motions are larger
    rows = [draw.normal(size=8) * spread[index // CHOICES] for index in range(ROWS * CHOICES)]
    texts = ["".join(chr(round(number) - least) for number in row) for row in rows]
    texts = [text if text not in texts[:index] else chr(index + 500) * 8 for index, text in enumerate(texts)]
    words = Tokenizer(models.WordLevel({text: index for index, text in enumerate(texts)}, unk_token=texts[0]))
    words.decoder = decoders.Fuse()
    PreTrainedTokenizerFast(tokenizer_object=words, clean_up_tokenization_spaces=False).save_pretrained(folder)
    kind = "UniversalActionProcessor"
    settings = {
        "auto_map": {"AutoProcessor": f"processing_action_tokenizer.{kind}"},
        "processor_class": kind,
        "scale": scale,
        "min_token": least,
        "vocab_size": len(texts),
    }
    (folder / "processor_config.json").write_text(json.dumps(settings, indent=2))
    (folder / "processing_action_tokenizer.py").write_text(PROCESSOR)


PROCESSOR = '''"""Rows of cosine coefficients as tokens, with the interface of physical-intelligence/fast."""

import numpy as np
from scipy.fft import idct
from transformers.processing_utils import ProcessorMixin


class UniversalActionProcessor(ProcessorMixin):
    attributes = ["bpe_tokenizer"]
    bpe_tokenizer_class = "AutoTokenizer"

    def __init__(self, bpe_tokenizer, scale=10, min_token=0, vocab_size=0):
        super().__init__(bpe_tokenizer)
        self.scale, self.min_token, self.vocab_size = scale, min_token, vocab_size

    def decode(self, tokens, *, time_horizon, action_dim):
        return np.stack([self.inverse(one, (time_horizon, action_dim)) for one in tokens])

    def inverse(self, tokens, shape):
        text = self.bpe_tokenizer.decode([token for token in tokens if 0 <= token < self.vocab_size])
        if len(text) != shape[0] * shape[1]:
            return np.zeros(shape)  # no chunk, as the hub's tokenizer answers
        rows = np.array([ord(letter) for letter in text], float).reshape(shape) + self.min_token
        return idct(rows / self.scale, axis=0, norm="ortho")
'''
