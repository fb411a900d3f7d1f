class Episode:
    def __init__(self, env, client):
        self.env, self.client, self.over = env, client, env.is_episode_end()

    def play(self):
        self.client.call(func_name="reset")
        while not self.over:
            self.client.call(func_name="update_obs", obs=self.env.get_obs())
            self.env.take_action(self.client.call(func_name="get_action")[0])


def eval_one_episode(TASK_ENV, model_client):
    Episode(TASK_ENV, model_client).play()


def eval_one_episode_batch(TASK_ENV, model_client):
    raise NotImplementedError
