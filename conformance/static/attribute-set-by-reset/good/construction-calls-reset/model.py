import numpy as np


class Model:
    def __init__(self, config):
        self.action_type = config["action_type"]
        self.policy = build(config["ckpt_name"])
        self.latest = {}
        self.reset()

    def update_obs(self, obs):
        self.update_obs_batch([obs])

    def update_obs_batch(self, obs_list):
        self.latest = {obs.get("env_idx", place): obs for place, obs in enumerate(obs_list)}

    def get_action(self):
        return self.get_action_batch()[0]

    def get_action_batch(self, env_idx_list=None):
        wanted = list(self.latest) if env_idx_list is None else env_idx_list
        return [self.act(self.latest[env]) for env in wanted]

    def reset(self):
        self.latest = {}

    limit = 4

    def act(self, obs):
        if not hasattr(self, "count"):
            self.count = 0
        self.pending.extend(self.policy(obs)[: self.limit])
        return [self.pending.popleft()]

    def reset(self):
        self.latest = {}
        self.pending = deque()
        self.count = 0
        self.limit = 4
