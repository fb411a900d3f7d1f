def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    obs = TASK_ENV.get_obs()
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=obs)
        (action,) = model_client.call(func_name="get_action")
        TASK_ENV.take_action(action)
        obs = TASK_ENV.get_obs()


def eval_one_episode_batch(TASK_ENV, model_client):
    raise NotImplementedError
