class Runner:
    def __init__(self, config):
        self.step = 0
        self.seen = None

    def observe(self, obs):
        self.seen = obs

    def act(self):
        self.step += 1
        return [self.seen["state"]] * self.step

    def clear(self):
        self.step, self.seen = 0, None
