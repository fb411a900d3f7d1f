from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def take_action_batch(self, actions, env_idx_list):
        states = [obs["state"] for obs in self.get_obs_batch(env_idx_list)]
        robot = self._setup.embodiment.dims(self._setup.action_type)
        whole = [{**{key: state[key] for key in robot}, **action} for state, action in zip(states, actions)]
        return super().take_action_batch(whole, env_idx_list)


def make(config):
    return Table(Reach, read_manifest(__file__), config)
