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


def _select(values, places):
    return [values[place] for place in places]


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")

    while not TASK_ENV.is_episode_end():
        env_idx_list = TASK_ENV.get_running_env_idx_list()
        observations = TASK_ENV.get_obs_batch(env_idx_list)
        model_client.call(func_name="update_obs_batch", obs=observations)
        actions = model_client.call(func_name="get_action_batch", obs=env_idx_list)
        size = len(actions[0])
        for place in range(size):
            TASK_ENV.take_action_batch([mine[place] for mine in actions], env_idx_list)
            if TASK_ENV.is_episode_end() or place + 1 == size:
                break
            running = set(TASK_ENV.get_running_env_idx_list())
            active = [place for place, env in enumerate(env_idx_list) if env in running]
            actions, env_idx_list = _select(actions, active), _select(env_idx_list, active)
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(env_idx_list))
