from .policy_head import build


class Model:
    def __init__(self, config):
        self.network = build(config["ckpt_name"])

    def update_obs(self, obs):
        self.observed = obs

    def get_action(self):
        return [self.network(self.observed)]

    def reset(self):
        self.observed = None
