"""Homogeneous matrices and scipy instead of quaternions."""

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from xpl import Policy
from xpl.observation import get_image

from .authors.pipeline import CENTRE, MEAN, REACH, STD, network


def matrix(place, turn):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turn.as_matrix(), place
    return result


BASE = matrix([0.0, -0.55, 0.765], Rotation.from_euler("Z", np.pi / 2))
TIP = matrix([0.0, 0.0, 0.1034], Rotation.from_rotvec([0.0, 0.0, -np.pi / 4]))


class Model(Policy):
    def load(self, config):
        self.network = network()

    def encode(self, obs, env):
        tip = self.tip(obs)
        opening = np.asarray(obs["state"]["ee_joint_state"], np.float64)[0]
        state = np.hstack([(tip[:3, 3] - CENTRE) / REACH, tip[0, :3], tip[1, :3], 0.04 * opening, -0.04 * opening])
        return {
            "head": self.seen(get_image(obs, "cam_head")),
            "wrist": self.seen(np.flip(get_image(obs, "cam_wrist"), (0, 1))),
            "state": state,
        }

    @staticmethod
    def tip(obs):
        pose = np.asarray(obs["state"]["ee_pose"], np.float64)
        world = matrix(pose[:3], Rotation.from_quat(pose[3:], scalar_first=True))
        return np.linalg.inv(BASE) @ world @ TIP

    @staticmethod
    def seen(image):
        small = Image.fromarray(np.ascontiguousarray(image)).resize((64, 64), Image.Resampling.BICUBIC)
        blue_first = np.asarray(small)[..., [2, 1, 0]] / np.float32(255)
        return np.moveaxis((blue_first - MEAN) / STD, -1, 0)

    def predict(self, inputs, envs):
        merged = [{name: np.stack([frame[name] for frame in frames]) for name in frames[0]} for frames in inputs]
        return np.stack([self.network(**item) for item in merged])

    def decode(self, raw, obs, env):
        tip = self.tip(obs)
        steps = []
        for row in raw.astype(np.float64):
            goal = np.eye(4)
            goal[:3, 3] = tip[:3, 3] + row[:3] / 50
            goal[:3, :3] = Rotation.from_rotvec(row[3:6] * 0.06).as_matrix() @ tip[:3, :3]
            world = BASE @ goal @ np.linalg.inv(TIP)
            quaternion = Rotation.from_matrix(world[:3, :3]).as_quat(canonical=True, scalar_first=True)
            steps.append(
                {
                    "ee_pose": np.hstack([world[:3, 3], quaternion]).astype(np.float32),
                    "ee_joint_state": np.asarray([0.5 - row[6] / 2], np.float32),
                }
            )
        return steps
