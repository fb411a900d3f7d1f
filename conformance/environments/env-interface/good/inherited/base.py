class Base:
    def __init__(self, config):
        self.config = config

    def reset(self, seed=None, options=None):
        self.steps = 0

    def get_obs(self):
        return {}

    def get_obs_batch(self, env_idx_list=None, last_frame=False):
        return [{}]

    def take_action(self, action):
        self.steps += 1

    def take_action_batch(self, actions, env_idx_list):
        self.steps += 1

    def is_episode_end(self):
        return self.steps > 9

    def get_running_env_idx_list(self):
        return [0]

    def results(self):
        return []

    def close(self):
        pass
