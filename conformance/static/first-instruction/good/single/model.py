class Model:
    def __init__(self, config):
        self.order, self.store = [], {}

    def update_obs(self, obs):
        self.store = {obs.get("env_idx", 0): obs}

    def get_action(self):
        return self.get_action_batch()[0]

    def get_action_batch(self, env_idx_list=None):
        return [[self.store[env]["state"]] for env in (self.order if env_idx_list is None else env_idx_list)]

    def reset(self):
        self.order, self.store = [], {}

    def update_obs_batch(self, obs_list):
        if len(obs_list) != 1:
            raise ValueError("this policy takes one environment at a time")
        self.prompt = obs_list[0]["instruction"]
        self.store = {0: obs_list[0]}
