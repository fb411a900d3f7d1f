import logging
import time

from tqdm import tqdm

LOG = logging.getLogger(__name__)
VERBOSE = False


def _frame(task_env, timeout=2.0):
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        seen = task_env.get_obs()
        if isinstance(seen, dict) and seen.get("vision"):
            return seen
        time.sleep(0.05)
    raise RuntimeError("no frame")


def eval_one_episode(TASK_ENV, model_client):
    started, count, log = time.time(), 0, []
    model_client.call(func_name="reset")
    seen = _frame(TASK_ENV)
    while True:
        if TASK_ENV.is_episode_end():
            break
        model_client.call("update_obs", seen)
        chunk = model_client.call(func_name="get_action")
        if chunk is None:
            raise RuntimeError("no answer")
        for action in tqdm(chunk, disable=not VERBOSE):
            if count and action is not chunk[0]:
                model_client.update_obs(obs=seen)
            TASK_ENV.take_action(action)
            count += 1
            if count % 50 == 0:
                LOG.info("%d actions in %.1f s", count, time.time() - started)
            log.append(count)
            seen = _frame(TASK_ENV)
            if TASK_ENV.is_episode_end():
                break
    print(f"{count} actions")


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
