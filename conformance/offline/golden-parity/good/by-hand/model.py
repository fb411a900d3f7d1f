import numpy as np

from xpl import Policy
from xpl.observation import get_image

from .network import Network


class Model(Policy):
    def load(self, config):
        self.network = Network()

    def encode(self, obs, env):
        image = get_image(obs, "cam_head")[1::2, 1::2, ::-1].astype(np.float32) / 127.5 - 1
        state = obs["state"]
        joints = np.asarray(state["arm_joint_state"]) / np.pi
        opening = 2 * state["ee_joint_state"] - 1
        return image, np.concatenate([joints, opening]).astype(np.float32), obs["instruction"]

    def predict(self, inputs, envs):
        return np.stack([self.network(image, state, "Task: " + text.strip(" ").lower()) for image, state, text in inputs])

    def decode(self, raw, obs, env):
        joints = obs["state"]["arm_joint_state"]
        return [
            {
                "arm_joint_state": (joints + 0.1 * row[:7]).astype(np.float32),
                "ee_joint_state": np.clip((row[7:] + 1) / 2, 0, 1).astype(np.float32),
            }
            for row in raw
        ]
