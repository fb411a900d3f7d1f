import numpy as np
from PIL import Image

from xpl import Policy
from xpl.observation import get_image

from .authors.pipeline import SIGN, ZERO, Agent


class Model(Policy):
    def load(self, config):
        self.agent = Agent()

    def encode(self, obs, env):
        text = "What should the robot do to " + obs["instruction"].strip().lower() + "?"
        return self.image(get_image(obs, "cam_head")), self.joints(obs), text

    def image(self, picture):
        height, width = picture.shape[:2]
        h, w = int(height * 0.8), int(width * 0.8)
        top, left = (height - h) // 2, (width - w) // 2
        middle = Image.fromarray(picture[top : top + h, left : left + w])
        return np.asarray(middle.resize((60, 60), Image.LANCZOS), np.float32) / 255.0

    def joints(self, obs):
        angles = np.rad2deg(np.asarray(obs["state"]["arm_joint_state"], np.float64)) * SIGN + ZERO
        percent = 100.0 * (1.0 - float(obs["state"]["ee_joint_state"][0]))
        return np.append(angles, percent)

    def predict(self, inputs, envs):
        answers = []
        for (image, joints, text), env in zip(inputs, envs):
            memory = self.memory(env)
            hidden = memory.value if memory.value is not None else self.agent.begin()
            rows, hidden = self.agent.step(hidden, image, joints, text)
            memory.keep(hidden)
            answers.append(rows)
        return np.stack(answers)

    def decode(self, raw, obs, env):
        start = self.joints(obs)[:6]
        steps = []
        for row in np.asarray(raw, np.float64):
            target = start + 2.0 * row[:6]
            angles = np.deg2rad((target - ZERO) * SIGN)
            opening = 0.5 - 0.5 * row[6]
            steps.append(
                {
                    "arm_joint_state": angles.astype(np.float32),
                    "ee_joint_state": np.array([opening], np.float32),
                }
            )
        return steps
