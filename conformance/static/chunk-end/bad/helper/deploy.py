def _seen(task_env):
    return task_env.get_obs()


def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=_seen(TASK_ENV))
        for action in model_client.call(func_name="get_action"):
            TASK_ENV.take_action(action)
            model_client.call(func_name="update_obs", obs=_seen(TASK_ENV))


def eval_one_episode_batch(TASK_ENV, model_client):
    raise NotImplementedError
