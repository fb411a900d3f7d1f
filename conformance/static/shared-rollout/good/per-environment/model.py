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

    def get_action_batch(self, env_idx_list=None):
        self.order = []
        for env in env_idx_list:
            self.order.append(env)
        return [self.next_chunk(env) for env in self.order]

    def next_chunk(self, env):
        self.calls += 1
        if self.calls % 100 == 0:
            print(f"call {self.calls}")
        prompt = self.by_env[env]["instruction"]
        if prompt not in self.embeddings:
            self.embeddings.update({prompt: self.embed(prompt)})
        self.history[env].append(self.by_env[env])
        self.steps[env] += 1
        return self.act(self.history[env][-1])[self.steps[env] :]
