"""The six operations by hand, without a base class."""

import numpy as np

from .authors import pipeline

VIEWS = {"top": "cam_head", "left_wrist": "cam_left_wrist", "right_wrist": "cam_right_wrist"}


class Model:
    def __init__(self, config):
        self.network = pipeline.network()
        self.newest = {}
        self.order = None

    def update_obs(self, obs):
        self.update_obs_batch([obs])

    def update_obs_batch(self, obs_list):
        self.order = []
        for obs in obs_list:
            env = int(obs.get("env_idx") or 0)
            self.newest[env] = obs
            self.order.append(env)

    def get_action(self):
        if not self.order:
            raise RuntimeError("get_action needs an observation since the last reset")
        return self.get_action_batch(self.order[:1])[0]

    def get_action_batch(self, env_idx_list=None):
        if env_idx_list is None:
            env_idx_list = self.order
        if env_idx_list is None:
            raise RuntimeError("get_action_batch needs an observation since the last reset")
        unknown = [env for env in env_idx_list if env not in self.newest]
        if unknown or len(set(env_idx_list)) != len(env_idx_list):
            raise RuntimeError(f"no observation of environments {unknown}, or one is asked for twice")
        return [self.chunk(self.newest[env]) for env in env_idx_list]

    def chunk(self, obs):
        told = obs["state"]
        state = np.hstack(
            [
                told["left_arm_joint_state"],
                0.044 * np.asarray(told["left_ee_joint_state"], np.float64),
                told["right_arm_joint_state"],
                0.044 * np.asarray(told["right_ee_joint_state"], np.float64),
            ]
        ).astype(np.float64)
        pictures = {view: np.asarray(obs["vision"][camera]["color"]) for view, camera in VIEWS.items()}
        rows = pipeline.sample(self.network, pictures, state, obs["instruction"])
        keys = ("left_arm_joint_state", "left_ee_joint_state", "right_arm_joint_state", "right_ee_joint_state")
        steps = []
        for row in rows:
            parts = np.split(np.asarray(row, np.float32), [6, 7, 13])
            parts[1], parts[3] = (np.clip(part / np.float32(0.044), 0, 1) for part in (parts[1], parts[3]))
            steps.append(dict(zip(keys, parts)))
        return steps

    def reset(self):
        self.newest = {}
        self.order = None
