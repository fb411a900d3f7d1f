from .runner import Runner


class Model:
    def __init__(self, config):
        self.runner = Runner()

    def update_obs(self, obs):
        self.runner.add(obs)

    def update_obs_batch(self, obs_list):
        for obs in obs_list:
            self.runner.add(obs)

    def get_action(self):
        return self.runner.act()

    def get_action_batch(self, env_idx_list=None):
        return [self.runner.act() for _ in env_idx_list]

    def reset(self):
        self.runner.reset()
