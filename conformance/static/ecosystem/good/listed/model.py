"""The same, but for observations that are kept in a list; how a batch is answered is each subject's own."""


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
