from xpl.environment import Environment, read_manifest

from .episode import Reach


class Table(Environment):
    def results(self):
        return [{**result, "score": 50.0} for result in super().results()]


def make(config):
    return Table(Reach, read_manifest(__file__), config)
