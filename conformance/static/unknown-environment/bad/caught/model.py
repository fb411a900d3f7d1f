class Model:
    def __init__(self, config):
        self.observed = []

    def update_obs(self, obs):
        self.update_obs_batch([obs])

    def update_obs_batch(self, obs_list):
        self.observed = obs_list

    def get_action(self):
        return self.get_action_batch()[0]

    def reset(self):
        self.observed = []

    def act(self, obs):
        return [obs["state"]]

    def get_action_batch(self, env_idx_list=None):
        return [self.act(self.found(env)) for env in env_idx_list]

    def found(self, env):
        try:
            obs = self.by_env[env]
        except KeyError:
            obs = self.by_env[0]
        return obs
