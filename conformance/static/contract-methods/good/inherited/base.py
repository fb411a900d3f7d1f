class Base:
    def update_obs(self, obs):
        self.update_obs_batch([obs])

    def get_action(self):
        return self.get_action_batch()[0]

    def reset(self):
        self.batch = []
