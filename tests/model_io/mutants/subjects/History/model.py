import numpy as np
from PIL import Image

from xpl import Policy
from xpl.observation import get_image

from .authors.pipeline import MEAN, STD, network

ARMS = ("left_", "right_")
FINGER = 0.05
FRAMES, STRIDE = 3, 2


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        small = Image.fromarray(get_image(obs, "cam_head")).resize((64, 48), Image.BILINEAR)
        picture = (np.asarray(small, np.float32) / 255.0).transpose(2, 0, 1)
        state = np.concatenate([self.arm(obs["state"], arm) for arm in ARMS])
        return picture, state, "Instruction: " + obs["instruction"].strip() + " Action:"

    def arm(self, state, arm):
        joints = (np.asarray(state[arm + "arm_joint_state"], np.float64) - MEAN) / STD
        finger = FINGER * float(state[arm + "ee_joint_state"][0])
        return np.append(joints[::-1], 2 * finger / FINGER - 1)

    def predict(self, inputs, envs):
        answers = []
        for frames in inputs:
            chosen = frames[::STRIDE]
            pictures = np.stack([frame[0] for frame in chosen])
            states = np.stack([frame[1] for frame in chosen])
            raw = self.network(pictures=pictures, states=states, text=frames[-1][2])
            rows = states[-1] + 0.05 * raw
            rows[:, [6, 13]] = raw[:, [6, 13]]
            answers.append(rows)
        return np.stack(answers)

    def decode(self, raw, obs, env):
        steps = []
        for row in np.asarray(raw, np.float64):
            step = {}
            for arm, part in zip(ARMS, (row[:7], row[7:])):
                step[arm + "arm_joint_state"] = (part[:6][::-1] * STD + MEAN).astype(np.float32)
                step[arm + "ee_joint_state"] = np.clip((part[6:7] + 1) / 2, 0, 1).astype(np.float32)
            steps.append(step)
        return steps
