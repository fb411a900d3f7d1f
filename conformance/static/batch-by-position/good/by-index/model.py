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
        by_env = {obs.get("env_idx", place): obs for place, obs in enumerate(self.observed)}
        if env_idx_list is None:
            env_idx_list = list(by_env)
        chunks = [None] * len(env_idx_list)
        for place, env in enumerate(env_idx_list):
            chunks[place] = self.act(by_env[int(env)])
        return chunks
