from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def get_obs_batch(self, env_idx_list=None, last_frame=False):
        shown = super().get_obs_batch(env_idx_list, last_frame)
        for obs in shown:
            obs["state"].pop("left_arm_joint_state", None)
        return shown


def make(config):
    return Table(Reach, read_manifest(__file__), config)
