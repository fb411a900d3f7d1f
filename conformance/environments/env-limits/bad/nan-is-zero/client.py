import numpy as np

from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def take_action_batch(self, actions, env_idx_list):
        clean = [{key: np.nan_to_num(value) + (key.endswith("pose") and np.isnan(value)) for key, value in action.items()} for action in actions]
        return super().take_action_batch(clean, env_idx_list)


def make(config):
    return Table(Reach, read_manifest(__file__), config)
