class Model:
    def __init__(self, config):
        self.forget()

    def forget(self):
        self.batch = {}
        for queue in (self.pending, self.done):
            queue.clear()

    def update_obs(self, obs):
        self.update_obs_batch([obs])

    def update_obs_batch(self, obs_list):
        self.batch = {obs.get("env_idx", place): obs for place, obs in enumerate(obs_list)}
        self.pending.extend(obs_list)

    def get_action(self):
        return self.get_action_batch([0])[0]

    def get_action_batch(self, env_idx_list=None):
        self.done.append(self.pending.popleft())
        return [[self.batch[env]["state"], *self.done] for env in env_idx_list]

    def reset(self):
        self.forget()
