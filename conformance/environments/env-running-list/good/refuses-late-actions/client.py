from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def take_action_batch(self, actions, env_idx_list):
        late = set(env_idx_list).difference(self.get_running_env_idx_list())
        if late:
            raise ValueError(f"the episodes of {late} have ended")
        return super().take_action_batch(actions, env_idx_list)


def make(config):
    return Table(Reach, read_manifest(__file__), config)
