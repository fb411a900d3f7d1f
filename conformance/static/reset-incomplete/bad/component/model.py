from .runner import Runner


class Model:
    def __init__(self, config):
        self.runner = self.build(config)

    def build(self, config):
        return Runner(config)

    def update_obs(self, obs):
        self.runner.observe(obs)

    def update_obs_batch(self, obs_list):
        raise ValueError("one environment at a time")

    def get_action(self):
        return self.runner.act()

    def get_action_batch(self, env_idx_list=None):
        raise ValueError("one environment at a time")

    def reset(self):
        self.runner.step = 0
