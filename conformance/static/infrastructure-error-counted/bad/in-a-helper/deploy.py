def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
    while not TASK_ENV.is_episode_end():
        for action in model_client.call(func_name="get_action"):
            executed(TASK_ENV, action)
            if TASK_ENV.is_episode_end():
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    return


def executed(env, action):
    try:
        env.take_action(action)
    except (ValueError, Exception):
        pass
