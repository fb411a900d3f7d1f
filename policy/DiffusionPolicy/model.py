"""Diffusion Policy of LeRobot, from a checkpoint of its training; `model_io` of policy.yml describes its interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl import Policy
from xpl import _spec as spec
from xpl.checkpoint import resolve

from .scene import scene


class Model(Policy):
    """Denoises a chunk of normalised actions, with separate noise for each environment."""

    def load(self, config: Mapping[str, Any]) -> None:
        """Load the policy; LeRobot is imported only here."""
        import torch
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

        self.torch = torch
        checkpoint = resolve(config, self.policy_dir)
        settings = PreTrainedConfig.from_pretrained(checkpoint)
        settings.device = "cuda" if torch.cuda.is_available() else "cpu"
        self.network = DiffusionPolicy.from_pretrained(checkpoint, config=settings).eval()
        self.settings = settings

    def predict(self, inputs: Mapping[str, np.ndarray], envs: Sequence[int]) -> np.ndarray:
        """Return one chunk for each environment, (B, H, 10), normalised."""
        shape = self.settings.horizon, self.settings.action_feature.shape[0]
        noise = np.stack([self.rng(env).standard_normal(shape, np.float32) for env in envs])
        with self.torch.inference_mode():
            batch = {name: self.torch.from_numpy(values).to(self.settings.device) for name, values in inputs.items()}
            if self.settings.image_features:
                images = [batch[name] for name in self.settings.image_features]
                batch["observation.images"] = self.torch.stack(images, dim=2)
            start = self.torch.from_numpy(noise).to(self.settings.device)
            chunks: np.ndarray = self.network.diffusion.generate_actions(batch, noise=start).float().cpu().numpy()
        return chunks


class StateModel(Model):
    """The variant `state`: also reads the state of the scene."""

    def encode(self, obs: Mapping[str, Any], env: int) -> dict[str, np.ndarray]:
        """Add the state of the scene to the inputs."""
        return {**super().encode(obs, env), "observation.environment_state": scene(obs[spec.Obs.PRIVILEGED])}

    def predict(self, inputs: Any, envs: Sequence[int]) -> np.ndarray:
        """Return one chunk for each environment, (B, H, 10), normalised."""
        batch = self.interface.batch(inputs)  # type: ignore[union-attr] # policy.yml has a block
        return super().predict(batch, envs)
