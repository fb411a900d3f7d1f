def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        actions = model_client.call(func_name="get_action")
        for index, action in enumerate(actions):
            TASK_ENV.take_action(action)
            if TASK_ENV.is_episode_end() or index + 1 == len(actions):
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())


def _someone_runs(env):
    return len(env.get_running_env_idx_list()) > 0


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while _someone_runs(TASK_ENV):
        envs = TASK_ENV.get_running_env_idx_list()
        model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
        chunks = dict(zip(envs, model_client.call(func_name="get_action_batch", obs=envs)))
        for step in range(min(len(chunk) for chunk in chunks.values())):
            TASK_ENV.take_action_batch([chunks[env][step] for env in envs], envs)
            envs = TASK_ENV.get_running_env_idx_list()
            if not _someone_runs(TASK_ENV):
                break
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
