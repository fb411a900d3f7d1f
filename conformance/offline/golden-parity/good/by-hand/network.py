"""The authors' network: a fixed function of numbers, which sees every pixel, number and letter."""

import zlib

import numpy as np

STEPS, ACTIONS = 4, 8


class Network:
    def __init__(self):
        rng = np.random.default_rng(3)
        self.view, self.memory = {}, rng.normal(size=(8, ACTIONS))
        self.rng = rng
        self.time = rng.normal(size=(STEPS, ACTIONS))

    def __call__(self, image, state, prompt):
        """image (h, w, 3) float, state (8,), prompt text: (STEPS, ACTIONS), all in -1..1."""
        if image.shape not in self.view:
            self.view[image.shape] = np.random.default_rng(image.size).normal(size=(image.size, ACTIONS)) / 40
        said = np.frombuffer(zlib.crc32(prompt.encode()).to_bytes(4, "little") * 2, np.uint8) / 255 - 0.5
        seen = image.reshape(-1) @ self.view[image.shape] + state @ self.memory / 3 + said
        return np.tanh(seen + self.time)
