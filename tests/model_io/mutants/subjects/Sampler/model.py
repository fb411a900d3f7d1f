import cv2
import numpy as np

from xpl import Policy, rotation
from xpl.observation import get_image

from .authors.pipeline import HIGH, LOW, STEPS, WIDTH, network

CAMERAS = ("cam_head", "cam_right_wrist", "cam_left_wrist")
ARMS = ("right_", "left_")


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        views = np.stack([self.pixels(get_image(obs, camera)) for camera in CAMERAS])
        return views, np.concatenate([self.arm(obs["state"], arm) for arm in ARMS])

    def pixels(self, image):
        small = cv2.resize(image, (32, 24), interpolation=cv2.INTER_AREA)
        return np.asarray(small, np.float32).transpose(2, 0, 1) / 255.0

    def arm(self, state, arm):
        pose = np.asarray(state[arm + "ee_pose"], np.float64)
        place = np.clip(2.0 * (pose[:3] - LOW) / (HIGH - LOW) - 1.0, -1.0, 1.0)
        quaternion = np.roll(pose[3:], -1)
        if quaternion[3] < 0:
            quaternion = -quaternion
        closing = 1.0 - float(state[arm + "ee_joint_state"][0])
        return np.concatenate([place, quaternion, [closing]])

    def predict(self, inputs, envs):
        answers = []
        for (views, state), env in zip(inputs, envs):
            noise = self.rng(env).standard_normal((STEPS, WIDTH))
            answers.append(self.network(views=views, state=state, noise=0.3 * noise))
        return np.stack(answers)

    def decode(self, raw, obs, env):
        steps = []
        for row in np.asarray(raw, np.float64):
            step = {}
            for arm, part in zip(ARMS, (row[:8], row[8:])):
                pose = np.asarray(obs["state"][arm + "ee_pose"], np.float64)
                place = pose[:3] + 0.03 * part[:3]
                turn = rotation.multiply(rotation.from_axis_angle(0.1 * part[3:6]), pose[3:])
                step[arm + "ee_pose"] = np.concatenate([place, turn]).astype(np.float32)
                step[arm + "ee_joint_state"] = np.array([(1.0 - part[7]) / 2.0], np.float32)
            steps.append(step)
        return steps
