import numpy as np


class Model:
    def __init__(self, config):
        self.weights = np.load(config["ckpt_name"])
        self.horizon = config["horizon"]

    def update_obs(self, obs):
        self.observed = [obs]

    def update_obs_batch(self, obs_list):
        self.observed = obs_list

    def get_action(self):
        return self.weights.decode(self.observed, self.horizon)

    def reset(self):
        self.observed = []
