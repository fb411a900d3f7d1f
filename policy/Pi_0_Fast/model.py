"""pi_0-FAST of openpi, from a checkpoint of its JAX training; `model_io` of policy.yml describes its interface."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xpl import Policy
from xpl.checkpoint import resolve


class Model(Policy):
    """Runs openpi's own policy, with its transforms and the checkpoint's statistics."""

    def load(self, config: Mapping[str, Any]) -> None:
        """Load the policy; openpi is imported only here."""
        from openpi.policies import droid_policy, policy_config
        from openpi.training import config as training

        checkpoint = resolve(config, self.policy_dir)
        train = training.get_config(config["train_config"])
        shape = checkpoint / "config.json"  # in the form of openpi's converter; released checkpoints have none
        changes = {**(json.loads(shape.read_text()) if shape.exists() else {}), **self.setting("model", {})}
        known = {field.name for field in dataclasses.fields(train.model)}
        model = dataclasses.replace(train.model, **{key: changes[key] for key in known & changes.keys()})
        self.network = policy_config.create_trained_policy(dataclasses.replace(train, model=model), checkpoint)
        self.network.infer(droid_policy.make_droid_example())  # compiles now, not at the first action

    def predict(self, inputs: Mapping[str, Any], envs: Sequence[int]) -> np.ndarray:
        """Return one chunk for each environment, (B, H, 8), in DROID's own numbers; openpi writes tokens one by one."""
        rows = [{name: values[row] for name, values in inputs.items()} for row in range(len(envs))]
        return np.stack([self.network.infer(row)["actions"] for row in rows])
