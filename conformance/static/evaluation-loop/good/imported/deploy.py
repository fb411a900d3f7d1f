from .loops import eval_one_episode
from .loops import eval_batch as eval_one_episode_batch
