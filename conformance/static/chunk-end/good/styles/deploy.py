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
        chunks = dict(zip(running, model_client.call(func_name="get_action_batch", obs=running)))
        while running and chunks[running[0]]:
            TASK_ENV.take_action_batch([chunks[env].pop(0) for env in running], running)
            running = TASK_ENV.get_running_env_idx_list()
            if not running:
                break
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(running))
