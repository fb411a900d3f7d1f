"""A policy that was fitted to demonstrations: ridge regression, or the mean of its nearest neighbours."""

from pathlib import Path

import numpy as np

from xpl import Policy


class Model(Policy):
    def load(self, config):
        with np.load(Path(__file__).parent / "weights.npz") as file:
            self.weights = {name: file[name] for name in file.files}
        self.texts = [str(text) for text in self.weights["texts"]]

    def features(self, inputs):
        """(B, D): state in deviations, pixels by a fixed random projection, and which text it is."""
        weights, rows = self.weights, len(inputs["state"])
        state = (inputs["state"].reshape(rows, -1) - weights["mean"]) / weights["std"]
        found = [state]
        if "image" in inputs:
            pixels = np.asarray(inputs["image"], np.float64).reshape(rows, -1) - weights["pixels"]
            found.append(pixels @ weights["projection"])
        if "prompt" in inputs:
            found.append(np.array([[4.0 * (text == one) for one in self.texts] for text in inputs["prompt"]]))
        return np.concatenate(found, axis=1)

    def predict(self, inputs, envs):
        weights, features = self.weights, self.features(inputs)
        shape = tuple(int(size) for size in weights["shape"])
        if "rows" not in weights:
            flat = np.concatenate([features, np.ones((len(features), 1))], axis=1) @ weights["matrix"]
            return np.clip(flat, weights["low"], weights["high"]).reshape(-1, *shape)
        far = ((features[:, None] - weights["rows"][None]) ** 2).sum(-1)
        near = np.exp(-(far - far.min(1, keepdims=True)) / (2 * float(weights["width"]) ** 2))
        flat = near @ weights["answers"] / near.sum(1, keepdims=True)
        return flat.reshape(-1, *shape)
