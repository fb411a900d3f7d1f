def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        TASK_ENV.take_action(model_client.call(func_name="get_action")[0])


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    running = TASK_ENV.get_running_env_idx_list()
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(running))
        chunks = model_client.call(func_name="get_action_batch", obs=running)
        TASK_ENV.take_action_batch([chunk[0] for chunk in chunks], running)
