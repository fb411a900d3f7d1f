import numpy as np


class Model:
    def __init__(self, config):
        self.rng = np.random.default_rng(config.get("run_seed", 0))

    def update_obs(self, obs):
        self.observed = obs

    def get_action(self):
        return [{"arm_joint_state": self.rng.normal(size=6), "ee_joint_state": np.zeros(1)}]

    def reset(self):
        self.observed = None
