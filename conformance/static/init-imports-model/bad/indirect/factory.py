from .model import Model


def make(config):
    return Model(config)
