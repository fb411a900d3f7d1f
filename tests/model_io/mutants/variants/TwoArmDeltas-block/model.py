import numpy as np

from xpl import Policy

from .authors.pipeline import network


class Model(Policy):
    def load(self, config):
        self.network = network()

    def predict(self, inputs, envs):
        rows = zip(inputs["images"], inputs["state"], inputs["text"])
        return np.stack([self.network(images=images, state=state, text=text) for images, state, text in rows])
