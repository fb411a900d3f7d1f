from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def take_action_batch(self, actions, env_idx_list):
        reports = super().take_action_batch(actions, env_idx_list)
        return [{**report, "corrections": {}} for report in reports]


def make(config):
    return Table(Reach, read_manifest(__file__), config)
