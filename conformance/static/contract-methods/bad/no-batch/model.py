class Model:
    def __init__(self, config):
        self.obs = None

    def update_obs(self, obs):
        self.obs = obs

    # def update_obs_batch(self, obs_list): ...

    def get_action(self):
        return [self.obs["state"]]

    def reset(self):
        self.obs = None
