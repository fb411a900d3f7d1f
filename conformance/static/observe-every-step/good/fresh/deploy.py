def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        frame = TASK_ENV.get_obs()
        action = model_client.call(func_name="step", obs=frame)
        TASK_ENV.take_action(action)


def eval_one_episode_batch(TASK_ENV, model_client):
    raise NotImplementedError
