from xpl.environment import Environment, read_manifest

from .episode import Reach


class TableError(Exception):
    pass


class Table(Environment):
    def take_action_batch(self, actions, env_idx_list):
        try:
            return super().take_action_batch(actions, env_idx_list)
        except ValueError as error:
            raise TableError(str(error)) from None


def make(config):
    return Table(Reach, read_manifest(__file__), config)
