PROMPT = "pick up the cube"


def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        obs = TASK_ENV.get_obs()
        obs["instruction"] = PROMPT
        model_client.call(func_name="update_obs", obs=obs)
        actions = model_client.call(func_name="get_action")
        for index, action in enumerate(actions):
            TASK_ENV.take_action(action)
            if TASK_ENV.is_episode_end() or index + 1 == len(actions):
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())


def eval_one_episode_batch(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        envs = TASK_ENV.get_running_env_idx_list()
        model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
        answer = model_client.call(func_name="get_action_batch", obs=envs)
        chunks = dict(zip(envs, answer))
        for step in range(len(answer[0])):
            TASK_ENV.take_action_batch([chunks[env][step] for env in envs], envs)
            envs = TASK_ENV.get_running_env_idx_list()
            if not envs or step + 1 == len(answer[0]):
                break
            model_client.call(func_name="update_obs_batch", obs=TASK_ENV.get_obs_batch(envs))
