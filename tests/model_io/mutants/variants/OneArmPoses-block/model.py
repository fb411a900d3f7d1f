import numpy as np

from xpl import Policy

from .authors.pipeline import network


class Model(Policy):
    def load(self, config):
        self.network = network()

    def predict(self, inputs, envs):
        rows = zip(inputs["head"], inputs["wrist"], inputs["state"])
        return np.stack([self.network(head=head, wrist=wrist, state=state) for head, wrist, state in rows])
