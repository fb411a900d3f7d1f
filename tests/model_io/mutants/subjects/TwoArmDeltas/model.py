import numpy as np
from PIL import Image

from xpl import Policy
from xpl.observation import get_image

from .authors.pipeline import ACTION_Q01, ACTION_Q99, EPS, Q01, Q99, network

FINGER = 0.044
CAMERAS = ("cam_head", "cam_left_wrist", "cam_right_wrist")
SIZE = 72


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        views = np.stack([self.view(get_image(obs, name)) for name in CAMERAS])
        state = self.proprioception(obs)
        return {
            "images": views.astype(np.float32) / 255.0 * 2.0 - 1.0,
            "state": (state - Q01) / (Q99 - Q01 + EPS) * 2.0 - 1.0,
            "text": obs["instruction"],
        }

    def view(self, image):
        height, width = image.shape[:2]
        ratio = max(height / SIZE, width / SIZE)
        h, w = int(height / ratio), int(width / ratio)
        frame = np.zeros((SIZE, SIZE, 3), np.uint8)
        top, left = (SIZE - h) // 2, (SIZE - w) // 2
        frame[top : top + h, left : left + w] = np.asarray(Image.fromarray(image).resize((w, h), Image.BILINEAR))
        return frame

    def proprioception(self, obs):
        body = obs["state"]
        left = np.concatenate([body["left_arm_joint_state"], FINGER * np.asarray(body["left_ee_joint_state"])])
        right = np.concatenate([body["right_arm_joint_state"], FINGER * np.asarray(body["right_ee_joint_state"])])
        return np.concatenate([left, right]).astype(np.float64)

    def predict(self, inputs, envs):
        return np.stack([self.network(**item) for item in inputs])

    def decode(self, raw, obs, env):
        actions = (raw + 1.0) / 2.0 * (ACTION_Q99 - ACTION_Q01 + EPS) + ACTION_Q01
        state = self.proprioception(obs)
        actions[:, :6] += state[:6]
        actions[:, 7:13] += state[7:13]
        steps = []
        for row in actions:
            steps.append(
                {
                    "left_arm_joint_state": row[:6].astype(np.float32),
                    "left_ee_joint_state": np.clip(row[6:7] / FINGER, 0, 1).astype(np.float32),
                    "right_arm_joint_state": row[7:13].astype(np.float32),
                    "right_ee_joint_state": np.clip(row[13:14] / FINGER, 0, 1).astype(np.float32),
                }
            )
        return steps
