def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
