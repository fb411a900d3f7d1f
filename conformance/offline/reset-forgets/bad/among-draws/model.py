"""An adapter of the ecosystem whose network draws its noise from numpy's global generator, in one array for a batch."""

import numpy as np


class Model:
    def __init__(self, config):
        self.observed = {}

    def update_obs(self, obs):
        self.update_obs_batch([obs])

    def update_obs_batch(self, obs_list):
        for place, obs in enumerate(obs_list):
            self.kept = self.__dict__.get("kept", float(obs["state"]["arm_joint_state"][0]))
        self.observed.update({obs.get("env_idx", place): obs for place, obs in enumerate(obs_list)})
        self.latest = [obs.get("env_idx", place) for place, obs in enumerate(obs_list)]

    def get_action(self):
        return self.get_action_batch([self.latest[0]])[0]

    def get_action_batch(self, env_idx_list=None):
        envs = self.latest if env_idx_list is None else env_idx_list
        noise = np.random.normal(0, 0.01, (len(envs), 4, 6)).astype(np.float32)
        return [self.act(self.observed[env]["state"], own) for env, own in zip(envs, noise)]

    def act(self, state, noise):
        joints, jaw = np.float32(state["arm_joint_state"]), np.float32(state["ee_joint_state"])
        return [{"arm_joint_state": joints * (1 + self.kept / 100) + own, "ee_joint_state": jaw} for own in noise]

    def reset(self):
        self.latest = []
