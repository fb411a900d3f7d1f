class Model:
    def __init__(self, config):
        self.reset()

    def update_obs(self, obs):
        self.prompt = obs["instruction"]
        self.obs = obs

    def update_obs_batch(self, obs_list):
        (obs,) = obs_list
        self.update_obs(obs)

    def get_action(self):
        return [self.network(self.prompt, self.obs["state"])]

    def get_action_batch(self, env_idx_list=None):
        return [self.get_action() for env in self.checked(env_idx_list)]

    def reset(self):
        self.obs = None
