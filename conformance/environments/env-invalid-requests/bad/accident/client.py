from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def take_action_batch(self, actions, env_idx_list):
        robot = self._setup.embodiment.dims(self._setup.action_type)
        return super().take_action_batch([{key: action[key] for key in robot} for action in actions], env_idx_list)


def make(config):
    return Table(Reach, read_manifest(__file__), config)
