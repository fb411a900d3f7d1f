from flow_head.sampler import FlowHead


class Model:
    def __init__(self, config):
        self.head = FlowHead(config.get("steps", 10))
        self.observed = {}

    def update_obs(self, obs):
        self.observed[0] = obs

    def update_obs_batch(self, obs_list):
        self.observed = {obs.get("env_idx", place): obs for place, obs in enumerate(obs_list)}

    def get_action(self):
        return self.get_action_batch([0])[0]

    def get_action_batch(self, env_idx_list=None):
        envs = list(self.observed) if env_idx_list is None else env_idx_list
        return [self.head.run(self.observed[env]) for env in envs]

    def reset(self):
        self.observed = {}
