def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        chunk = model_client.call(func_name="get_action")
        for place, action in enumerate(chunk):
            TASK_ENV.take_action(action)
            done = TASK_ENV.is_episode_end()
            if done or place + 1 == len(chunk):
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while running := TASK_ENV.get_running_env_idx_list():
        model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(running))
        chunks = model_client.call(func_name="get_action_batch", obs=running)
        while chunks[0] and not TASK_ENV.is_episode_end():
            TASK_ENV.take_action_batch([chunk.pop(0) for chunk in chunks], running)
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(running))
