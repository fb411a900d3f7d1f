import numpy as np


class Model:
    def __init__(self, config):
        self.weights = np.load(config["weights_file"])
        self.action_type = config["action_type"]
        if self.action_type != "joint":
            raise ValueError(self.action_type)

    def update_obs(self, obs):
        self.observed = [obs]

    def update_obs_batch(self, obs_list):
        self.observed = obs_list

    def get_action(self):
        return [{"arm_joint_state": self.weights, "ee_joint_state": np.zeros(1)}]

    def reset(self):
        self.observed = []
