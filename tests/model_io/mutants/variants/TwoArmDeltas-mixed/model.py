"""The block makes pictures, vectors and units; code around it makes numbers of pixels, quantiles and deltas."""

import numpy as np

from xpl import Policy

from .authors.pipeline import EPS, Q01, Q99, network

JOINTS = ("left_arm_joint_state", "right_arm_joint_state")


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        inputs = super().encode(obs, env)
        views, text = inputs["images"], inputs["text"]
        inputs["images"] = views.astype(np.float32) / 127.5 - 1.0
        inputs["state"] = (inputs["state"] - Q01) / (Q99 - Q01 + EPS) * 2.0 - 1.0
        inputs["text"] = text
        return inputs

    def predict(self, inputs, envs):
        return np.stack([self.network(**item) for item in inputs])

    def decode(self, raw, obs, env):
        steps = super().decode(raw, obs, env)
        start = {key: np.asarray(obs["state"][key], np.float32) for key in JOINTS}
        for step in steps:
            for key in JOINTS:
                step[key] = start[key] + step[key]
        return steps
