"""Keeps what `encode` made under its own index, and counts backwards."""

import numpy as np
from PIL import Image

from xpl import Policy
from xpl.observation import get_image

from .authors import pipeline


class Model(Policy):
    def load(self, config):
        self.network = pipeline.network()

    def encode(self, obs, env):
        told = obs["state"]
        sides = []
        for side in ("left", "right"):
            arm = np.asarray(told[f"{side}_arm_joint_state"], np.float64)
            sides.append(pipeline.normal(arm, 0.05 * float(told[f"{side}_ee_joint_state"][0])))
        return pipeline.frame(get_image(obs, "cam_head")), np.concatenate(sides), obs["instruction"]

    def predict(self, inputs, envs):
        return np.stack([self.answer(frames) for frames in inputs])

    def answer(self, frames):
        newest = len(frames) - 1
        kept = [frames[newest - 4], frames[newest - 2], frames[newest]]
        return pipeline.act(self.network, [one[0] for one in kept], [one[1] for one in kept], kept[-1][2])

    def decode(self, raw, obs, env):
        left, right = raw[:, :7].astype(np.float64), raw[:, 7:].astype(np.float64)
        return [
            {
                "left_arm_joint_state": one[5::-1] * pipeline.STD + pipeline.MEAN,
                "left_ee_joint_state": np.clip([(1 + one[6]) / 2], 0, 1),
                "right_arm_joint_state": two[5::-1] * pipeline.STD + pipeline.MEAN,
                "right_ee_joint_state": np.clip([(1 + two[6]) / 2], 0, 1),
            }
            for one, two in zip(left, right)
        ]
