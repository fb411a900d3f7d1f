class Runner:
    def __init__(self):
        self.seen = []

    def add(self, obs):
        self.seen += [obs]

    def act(self):
        return self.policy(self.seen[-2:])

    def reset(self):
        self.seen = []
