import numpy as np
from PIL import Image

from xpl import Policy, rotation
from xpl.observation import get_image

from .authors.pipeline import CENTRE, MEAN, REACH, STD, network

BASE = np.array([0.0, -0.55, 0.765])
BASE_TURN = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
TIP = np.array([0.0, 0.0, 0.1034])
TIP_TURN = np.array([np.cos(np.pi / 8), 0.0, 0.0, -np.sin(np.pi / 8)])
FINGER = 0.04


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        place, turn = self.tip(obs)
        opening = float(obs["state"]["ee_joint_state"][0])
        rows = rotation.to_matrix(turn)[:2].ravel()
        state = np.concatenate([(place - CENTRE) / REACH, rows, [FINGER * opening, -FINGER * opening]])
        head = self.picture(get_image(obs, "cam_head"))
        wrist = self.picture(np.rot90(get_image(obs, "cam_wrist"), 2))
        return head, wrist, state

    def picture(self, image):
        bgr = np.ascontiguousarray(image[:, :, ::-1])
        small = np.asarray(Image.fromarray(bgr).resize((64, 64), Image.BICUBIC)).astype(np.float32) / 255.0
        return ((small - MEAN) / STD).transpose(2, 0, 1)

    def tip(self, obs):
        pose = np.asarray(obs["state"]["ee_pose"], np.float64)
        turn = pose[3:7]
        place = pose[:3] + rotation.rotate(turn, TIP)
        back = rotation.conjugate(BASE_TURN)
        return rotation.rotate(back, place - BASE), rotation.multiply(rotation.multiply(back, turn), TIP_TURN)

    def predict(self, inputs, envs):
        answers = []
        for frames in inputs:
            heads, wrists, states = (np.stack(items) for items in zip(*frames))
            answers.append(self.network(head=heads, wrist=wrists, state=states))
        return np.stack(answers)

    def decode(self, raw, obs, env):
        place, turn = self.tip(obs)
        steps = []
        for row in np.asarray(raw, np.float64):
            moved = place + 0.02 * row[:3]
            turned = rotation.multiply(rotation.from_axis_angle(0.06 * row[3:6]), turn)
            world = rotation.multiply(rotation.multiply(BASE_TURN, turned), rotation.conjugate(TIP_TURN))
            flange = rotation.rotate(BASE_TURN, moved) + BASE - rotation.rotate(world, TIP)
            opening = (1.0 - row[6]) / 2.0
            steps.append(
                {
                    "ee_pose": np.concatenate([flange, world]).astype(np.float32),
                    "ee_joint_state": np.array([opening], np.float32),
                }
            )
        return steps
