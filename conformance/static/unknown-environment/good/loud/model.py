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
        gains = [self.gains.get(env, 1.0) for env in env_idx_list]
        chunks = []
        for env, gain in zip(env_idx_list, gains):
            obs = self.by_env.get(env)
            if obs is None:
                raise KeyError(f"environment {env} was not observed")
            chunks.append(self.act(obs, gain))
        return chunks
