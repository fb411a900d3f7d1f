def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
    while not TASK_ENV.is_episode_end():
        for action in model_client.call(func_name="get_action"):
            TASK_ENV.take_action(action)
            if TASK_ENV.is_episode_end():
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    num_envs = 4
    while not TASK_ENV.is_episode_end():
        for env_idx in range(num_envs):
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs_batch([env_idx])[0])
            TASK_ENV.take_action_batch(model_client.call(func_name="get_action"), [env_idx])
