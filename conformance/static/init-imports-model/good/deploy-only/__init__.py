from .deploy import eval_one_episode, eval_one_episode_batch

__all__ = ["eval_one_episode", "eval_one_episode_batch"]
