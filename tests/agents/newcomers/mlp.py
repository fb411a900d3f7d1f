"""A perceptron in PyTorch that reads several observations at once. Its authors' code."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
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


class Runner:
    """How its authors run it: joints in rad and the opening of the gripper, of the last observations, oldest first."""

    def __init__(self, weights: Path, statistics: Path) -> None:
        saved = torch.load(weights, map_location="cpu", weights_only=True)
        self.numbers = {name: torch.tensor(values) for name, values in json.loads(statistics.read_text()).items()}
        self.frames: int = saved["frames"]
        self.network = Perceptron(saved).eval()
        self.network.load_state_dict(saved["weights"])

    def act(self, states: Sequence[Sequence[float]]) -> torch.Tensor:
        """Return targets (H, D); where there are not enough states, the first one stands for those before it."""
        seen = [states[0]] * (self.frames - len(states)) + list(states[-self.frames :])
        inner = (torch.tensor(seen) - self.numbers["state_mean"]) / self.numbers["state_std"]
        with torch.inference_mode():
            answer = self.network(inner.flatten()[None])
        return answer.reshape(self.network.steps, -1) * self.numbers["action_std"] + self.numbers["action_mean"]
