def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    for _ in range(20):
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        TASK_ENV.take_action(model_client.call(func_name="get_action")[0])
        if TASK_ENV.is_episode_end():
            break


def eval_one_episode_batch(TASK_ENV, model_client):
    raise NotImplementedError
