import numpy as np
from PIL import Image

from xpl import Policy
from xpl.observation import get_image

from .authors.pipeline import network

SIZE = 56
SCALE = np.array([1.5, 1.0, 1.2, 1.5, 2.0, 2.0, 1.0])


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        scene = self.view(get_image(obs, "cam_head"))
        hand = self.view(get_image(obs, "cam_wrist"))
        return np.hstack([scene, hand]) / 255.0 - 0.5

    def view(self, image):
        turned = np.ascontiguousarray(image[::-1, ::-1])
        return np.asarray(Image.fromarray(turned).resize((SIZE, SIZE), Image.BILINEAR))

    def predict(self, inputs, envs):
        return np.stack([self.network(picture=picture) for picture in inputs])

    def decode(self, raw, obs, env):
        changes = np.asarray(raw, np.float64) * SCALE
        start = np.asarray(obs["state"]["arm_joint_state"], np.float64)
        angles = start + np.cumsum(np.deg2rad(changes[:, :6]), axis=0)
        openings = (changes[:, 6:] + 1) / 2
        return [
            {"arm_joint_state": angle.astype(np.float32), "ee_joint_state": opening.astype(np.float32)}
            for angle, opening in zip(angles, openings)
        ]
