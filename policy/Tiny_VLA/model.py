"""Model of Tiny_VLA: network.py defines it, train.py trains it, and this file runs it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xpl import Policy
from xpl.checkpoint import resolve


class Model(Policy):
    """Runs the network, all environments in one forward pass."""

    def load(self, config: Mapping[str, Any]) -> None:
        """Load the network from the checkpoint of deploy.yml; PyTorch is imported only here."""
        import torch

        from .network import pieces, read

        self.torch, self.pieces = torch, pieces
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.network = read(resolve(config, self.policy_dir)).to(self.device).eval()

    def predict(self, inputs: Mapping[str, Any], envs: list[int]) -> np.ndarray:
        """Return a chunk of normalised actions for each environment, (B, H, D)."""
        arrays = {**inputs, "instruction": self.pieces(inputs["instruction"])}
        with self.torch.inference_mode():
            batch = {name: self.torch.from_numpy(values).to(self.device) for name, values in arrays.items()}
            chunks, _grasp = self.network(**batch)
        answer: np.ndarray = chunks.cpu().numpy()
        return answer
