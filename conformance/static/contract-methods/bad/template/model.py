from framework.model_template import ModelTemplate


class Model(ModelTemplate):
    def __init__(self, config):
        self.obs = None

    def update_obs(self, obs):
        self.obs = obs

    def get_action(self):
        return [self.obs["state"]]
