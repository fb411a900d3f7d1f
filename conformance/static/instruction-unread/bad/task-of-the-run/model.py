import numpy as np


class Model:
    def __init__(self, config):
        self.weights = np.load(config["ckpt_name"])
        self.goal = self.text_encoder(config["task_name"].replace("_", " "))
        if config["action_type"] != "joint":
            raise ValueError(config["action_type"])

    def text_encoder(self, words):
        return np.frombuffer(words.encode(), dtype=np.uint8)

    def update_obs(self, obs):
        self.observed = [obs["state"]]

    def update_obs_batch(self, obs_list):
        self.observed = [obs["state"] for obs in obs_list]

    def get_action(self):
        row = self.weights @ self.goal
        return [{"arm_joint_state": row[:6], "ee_joint_state": row[6:]}]

    def reset(self):
        self.observed = []
