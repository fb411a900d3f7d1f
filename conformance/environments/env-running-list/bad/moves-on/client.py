from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def take_action_batch(self, actions, env_idx_list):
        reports = super().take_action_batch(actions, env_idx_list)
        for env, action in zip(env_idx_list, actions):
            self._env(env)._episode.joints[0] = self._env(env)._episode.joints[0] + 0.01
        return reports


def make(config):
    return Table(Reach, read_manifest(__file__), config)
