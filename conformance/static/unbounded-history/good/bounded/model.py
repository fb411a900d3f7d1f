import numpy as np


class Model:
    def __init__(self, config):
        self.action_type = config["action_type"]
        self.policy = build(config["ckpt_name"])
        self.latest = {}
        self.frames = deque(maxlen=4)
        self.states, self.first = [], []
        self.windows = {}
        self.pending = deque()

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

    def update_obs_batch(self, obs_list):
        self.latest = {}
        self.order = []
        for obs in obs_list:
            self.latest[obs["env_idx"]] = obs
            self.order.append(obs["env_idx"])
            self.frames.append(obs["vision"])
            self.states.append(obs["state"])
            self.windows.setdefault(obs["env_idx"], deque(maxlen=4)).append(obs)
        self.states = self.states[-4:]

    def act(self, obs):
        if len(self.first) < 3:
            self.first.append(obs)
        self.pending.extend(self.policy(obs))
        return [self.pending.popleft()]
