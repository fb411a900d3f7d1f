"""Network of Tiny_VLA: two cameras, a state and an instruction in, an action chunk out.

Each camera goes through a small convolutional stem whose blocks are scaled and shifted by the sentence (FiLM, as in
RT-1), so that what it names stands out before anything is averaged. Patches, words and the state are tokens of a
transformer; one query for each step of the chunk reads them (as ACT's decoder). A further query says where the arm is
when its gripper closes: a target that every episode holds, and that only the sentence can tell.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional

CAMERAS = ("head", "wrist")
SLOTS, MOST_WORDS, PIECES = 2048, 20, 10
_GRID = 12  # patches on a side of an image of 96 pixels; the head's are averaged to half as many


def pieces(sentences: Sequence[str]) -> np.ndarray:
    """Return sentences as numbers, with no vocabulary: (B, words, pieces) int64 slots, 0 where there is none.

    A word is itself and its letter trigrams, each hashed to a slot of one table, whose mean is the word's token (as in
    fastText). A word that training never saw shares pieces with those that it resembles. What is longer is cut.
    """
    table = np.zeros((len(sentences), MOST_WORDS, PIECES), np.int64)
    for row, sentence in enumerate(sentences):
        for place, word in enumerate(re.findall(r"[^\W_]+", sentence.lower())[:MOST_WORDS]):
            marked = f"<{word}>"
            parts = [marked, *(marked[start : start + 3] for start in range(len(marked) - 2))][:PIECES]
            table[row, place, : len(parts)] = [1 + zlib.crc32(part.encode()) % (SLOTS - 1) for part in parts]
    return table


def read(path: Path) -> Network:
    """Return the network of a checkpoint: a safetensors file, whose metadata hold its sizes, or the folder of one."""
    with safe_open(path / "model.safetensors" if path.is_dir() else path, "pt") as file:
        network = Network(**json.loads(file.metadata()["sizes"]))
        network.load_state_dict({name: file.get_tensor(name).float() for name in file.keys()})  # noqa: SIM118 - no map
    return network


def write(weights: dict[str, torch.Tensor], sizes: dict[str, int], path: Path) -> None:
    """Write weights in half precision, in the format of `read`, atomically."""
    halves = {name: values.detach().half().cpu().contiguous() for name, values in weights.items()}
    save_file(halves, f"{path}.part", {"sizes": json.dumps(sizes)})
    Path(f"{path}.part").replace(path)


class Network(nn.Module):
    """The whole policy network.

    Args:
        width: of tokens, a multiple of `heads`.
        heads: of attention.
        encoder: layers over all tokens.
        decoder: layers of the queries.
        chunk: steps of an answer.
        dim: numbers of a state and of a command, in the same order and normalised alike.
        dropout: share of features that training leaves out.
    """

    def __init__(
        self, width: int, heads: int, encoder: int, decoder: int, chunk: int, dim: int, dropout: float = 0.0
    ) -> None:
        super().__init__()
        self.pieces = nn.EmbeddingBag(SLOTS, width, mode="mean", padding_idx=0)
        self.text = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))
        self.eyes = nn.ModuleDict({camera: Stem(width) for camera in CAMERAS})
        self.state = nn.Sequential(nn.Linear(dim, width), nn.GELU(), nn.Linear(width, width))
        tokens = _GRID**2 + (_GRID // 2) ** 2 + 1 + MOST_WORDS
        self.places = nn.Parameter(torch.randn(tokens, width) * 0.02)
        self.encoder = nn.ModuleList(Layer(width, heads, dropout, crosses=False) for _ in range(encoder))
        self.queries = nn.Parameter(torch.randn(chunk + 1, width) * 0.02)
        self.decoder = nn.ModuleList(Layer(width, heads, dropout, crosses=True) for _ in range(decoder))
        self.memory, self.last = nn.LayerNorm(width), nn.LayerNorm(width)
        self.command, self.grasp = nn.Linear(width, dim), nn.Linear(width, dim)
        self.carry = nn.Parameter(torch.ones(dim))

    def forward(
        self, head: torch.Tensor, wrist: torch.Tensor, state: torch.Tensor, instruction: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return actions (B, chunk, D) and the command at which the gripper closes (B, D), normalised.

        Args:
            head: (B, 96, 96, 3), bytes or numbers from 0 to 255.
            wrist: likewise.
            state: (B, D), normalised.
            instruction: (B, words, pieces), as `pieces` makes them.
        """
        count = len(state)
        absent = instruction.amax(-1) == 0
        words = self.pieces(instruction.reshape(-1, PIECES)).view(count, MOST_WORDS, -1)
        present = (~absent)[..., None].to(words.dtype)
        said = self.text((words * present).sum(1) / present.sum(1).clamp(min=1))
        near, far = self.eyes["wrist"](wrist, said), functional.avg_pool2d(self.eyes["head"](head, said), 2)
        seen = [patches.flatten(2).transpose(1, 2) for patches in (near, far)]
        tokens = torch.cat([*seen, self.state(state)[:, None], words], 1) + self.places
        hidden = torch.zeros(count, tokens.shape[1], dtype=torch.bool, device=tokens.device)
        hidden[:, -MOST_WORDS:] = absent
        mask = ~hidden[:, None, None]
        for layer in self.encoder:
            tokens = layer(tokens, tokens, mask)
        tokens, asked = self.memory(tokens), self.queries.expand(count, -1, -1)
        for layer in self.decoder:
            asked = layer(asked, tokens, mask)
        answers = self.last(asked)
        commands = state[:, None] * self.carry + self.command(answers[:, :-1])
        if not self.training:  # grippers cannot open further
            commands[..., -1] = commands[..., -1].clamp(-1, 1)
        return commands, self.grasp(answers[:, -1])


class Stem(nn.Module):
    """Turns an image of 96 pixels into 12 x 12 patches; a sentence scales and shifts the channels of its blocks."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Conv2d(3, 32, 5, stride=2, padding=2), nn.GroupNorm(4, 32), nn.GELU())
        self.blocks = nn.ModuleList([Block(32, 64, 2), Block(64, width, 2), Block(width, width, 1)])
        self.films = nn.ModuleList([nn.Linear(width, 2 * 64), nn.Linear(width, 2 * width), nn.Linear(width, 2 * width)])
        for film in self.films:
            nn.init.zeros_(film.weight)
            nn.init.zeros_(film.bias)

    def forward(self, image: torch.Tensor, said: torch.Tensor) -> torch.Tensor:
        """Return (B, width, 12, 12) of an image (B, 96, 96, 3), of bytes or of numbers from 0 to 255."""
        seen = self.first(image.movedim(-1, 1).to(said.dtype) / 127.5 - 1)
        for block, film in zip(self.blocks, self.films):
            scale, shift = film(said)[..., None, None].chunk(2, 1)
            seen = block(seen, 1 + scale, shift)
        return seen


class Block(nn.Module):
    """A residual block of two convolutions."""

    def __init__(self, wide: int, width: int, stride: int) -> None:
        super().__init__()
        self.one = nn.Conv2d(wide, width, 3, stride=stride, padding=1)
        self.two = nn.Conv2d(width, width, 3, padding=1)
        self.norms = nn.ModuleList([nn.GroupNorm(8, width), nn.GroupNorm(8, width)])
        self.short = nn.Conv2d(wide, width, 1, stride=stride)

    def forward(self, seen: torch.Tensor, scale: torch.Tensor, shift: torch.Tensor) -> torch.Tensor:
        """Return the features, scaled and shifted between the convolutions."""
        inner = functional.gelu(self.norms[0](self.one(seen)) * scale + shift)
        result: torch.Tensor = functional.gelu(self.norms[1](self.two(inner)) + self.short(seen))
        return result


class Layer(nn.Module):
    """A layer of a transformer, normalised before each part; one that `crosses` attends to itself, then to others."""

    def __init__(self, width: int, heads: int, dropout: float, *, crosses: bool) -> None:
        super().__init__()
        self.within = Attention(width, heads) if crosses else None
        self.across = Attention(width, heads)
        self.wide = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 4 * width), nn.GELU())
        self.narrow, self.dropout = nn.Linear(4 * width, width), nn.Dropout(dropout)
        self.norms = nn.ModuleList([nn.LayerNorm(width), nn.LayerNorm(width)])

    def forward(self, tokens: torch.Tensor, others: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Return tokens (B, T, W) that have attended to others (B, S, W), where `mask` (B, 1, 1, S) is true."""
        if self.within is not None:
            normed = self.norms[0](tokens)
            tokens = tokens + self.dropout(self.within(normed, normed, None))
        normed = self.norms[1](tokens)
        tokens = tokens + self.dropout(self.across(normed, normed if self.within is None else others, mask))
        result: torch.Tensor = tokens + self.dropout(self.narrow(self.wide(tokens)))
        return result


class Attention(nn.Module):
    """Attention with several heads."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.pair, self.out = nn.Linear(width, width), nn.Linear(width, 2 * width), nn.Linear(width, width)

    def forward(self, tokens: torch.Tensor, others: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
        """Return the attention of tokens (B, T, W) over others (B, S, W)."""
        parts = [self.query(tokens), *self.pair(others).chunk(2, -1)]
        query, key, value = (part.unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in parts)
        gathered = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        result: torch.Tensor = self.out(gathered.transpose(1, 2).flatten(2))
        return result
