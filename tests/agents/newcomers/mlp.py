"""A perceptron in PyTorch that reads several observations at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn


class Perceptron(nn.Module):
    """Maps (B, T * D) normalised states, oldest first, to (B, H * D) normalised targets: the newest, nearer to rest."""

    def __init__(self, saved: Mapping[str, Any]) -> None:
        super().__init__()
        self.width, self.steps = saved["width"], saved["steps"]
        hidden = saved["hidden"]
        self.layers = nn.Sequential(
            nn.Linear(self.width * saved["frames"], hidden),
            nn.ReLU(),
            nn.Linear(hidden, self.width * self.steps),
            nn.Tanh(),
        )

    def forward(self, frames: torch.Tensor) -> torch.Tensor:
        """Return the targets of a batch."""
        newest = frames[:, -self.width :].repeat(1, self.steps)
        return 0.9 * newest + 0.05 * self.layers(frames)
