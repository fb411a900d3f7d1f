"""The block knows pictures, frames and points; code around it packs the state and unpacks the answer."""

import numpy as np

from xpl import Policy

from .authors.pipeline import network

MOVE, TURN = 0.02, 0.06


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        inputs = super().encode(obs, env)
        place, matrix, finger = np.split(inputs["state"], [3, 12])
        rows = matrix.reshape(3, 3)[:2]
        inputs["state"] = np.concatenate([place, rows.ravel(), finger, -finger])
        return inputs

    def predict(self, inputs, envs):
        shown = self.interface.batch(inputs)
        rows = zip(shown["head"], shown["wrist"], shown["state"])
        return np.stack([self.network(head=head, wrist=wrist, state=state) for head, wrist, state in rows])

    def decode(self, raw, obs, env):
        answer = np.asarray(raw, np.float64).copy()
        answer[:, :3] *= MOVE
        answer[:, 3:6] *= TURN
        answer[:, 6] = (1.0 - answer[:, 6]) / 2.0
        return super().decode(answer, obs, env)
