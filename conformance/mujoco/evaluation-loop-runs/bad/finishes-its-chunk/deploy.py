def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    over = TASK_ENV.is_episode_end
    while not over():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        chunk = model_client.call(func_name="get_action")
        list(map(TASK_ENV.take_action, chunk))


def eval_one_episode_batch(TASK_ENV, model_client):
    eval_one_episode(TASK_ENV, model_client)
