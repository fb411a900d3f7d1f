from .base import Base


class Model(Base):
    def __init__(self, config):
        self.batch = []

    def update_obs_batch(self, obs_list):
        self.batch = obs_list

    def get_action_batch(self, env_idx_list=None):
        by_env = {obs["env_idx"]: obs for obs in self.batch}
        return [[by_env[env]["state"]] for env in (by_env if env_idx_list is None else env_idx_list)]
