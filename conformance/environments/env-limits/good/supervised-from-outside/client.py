from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    guarded = False

    def take_action_batch(self, actions, env_idx_list):
        super().take_action_batch(actions, env_idx_list)


def make(config):
    return Table(Reach, read_manifest(__file__), config)
