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
        chunk = self.act(self.observed[0])
        return [chunk for _ in env_idx_list]
