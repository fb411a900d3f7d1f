def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while TASK_ENV.get_running_env_idx_list():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        for action in model_client.call(func_name="get_action"):
            TASK_ENV.take_action(action)
            if not TASK_ENV.get_running_env_idx_list():
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        envs = TASK_ENV.get_running_env_idx_list()
        model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
        chunks = dict(zip(envs, model_client.call(func_name="get_action_batch", obs=envs)))
        for step in range(min(len(chunk) for chunk in chunks.values())):
            TASK_ENV.take_action_batch([chunks[env][step] for env in envs], envs)
            envs = TASK_ENV.get_running_env_idx_list()
            if not envs or TASK_ENV.is_episode_end():
                break
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
