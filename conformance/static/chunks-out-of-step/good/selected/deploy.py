def eval_one_episode(TASK_ENV, model_client):
    raise NotImplementedError


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        running = TASK_ENV.get_running_env_idx_list()
        model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(running))
        answer = model_client.call(func_name="get_action_batch", obs=running)
        for step in range(len(answer[0])):
            actions = [chunk[step] for chunk in answer]
            TASK_ENV.take_action_batch(actions, running)
            if TASK_ENV.is_episode_end():
                break
            still = set(TASK_ENV.get_running_env_idx_list())
            places = [place for place, env in enumerate(running) if env in still]
            answer = [answer[place] for place in places]
            running = [running[place] for place in places]
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(running))
